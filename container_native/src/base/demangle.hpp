#pragma once

#include <string>

namespace play_launch {

/// The name of a C++ function or type as people write it; what is no mangled name stays as it is.
/// Allocates.
std::string demangled(const char* name);

}  // namespace play_launch
