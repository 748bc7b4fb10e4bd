#pragma once

#include <string>

namespace play_launch::container {

/// Whether the library of a component can be opened, tried out in this process instead of in the
/// container that is to have it: finds the library as a load does, opens it, and ends without
/// making a node, or a participant. Writes one line to stdout, a JSON object
///   {"library": path, "error": text, "signal": number, "modules": [line, ...],
///    "backtrace": [line, ...]}
/// in which `error` is empty when the library can be opened, `signal` is 0 unless a signal ended
/// it, and `backtrace` is innermost first. What the library writes to stdout goes to stderr.
/// Returns the exit status: kExitOk, or kExitFailed when the library cannot be opened. There is no
/// time limit; killing this process kills all that it started.
///
/// To be called before there are other threads.
int probe(const std::string& package, const std::string& plugin);

}  // namespace play_launch::container
