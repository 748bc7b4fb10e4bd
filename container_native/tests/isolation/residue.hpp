#pragma once

/// A library whose code leaves something with the thread that calls it.

/// What the destructor does after its report: nothing, or what a broken one does.
enum class Deed { nothing, fault, raise, loop, another };

/// Where destructors report that they run: a counter of the test's, for each process.
using Report = void (*)();

extern "C" {
/// A thread_local object. `another`: its destructor makes one more.
void leave_object(Deed deed, Report report);
/// A value of a pthread key. `another`: it comes back without end.
void leave_value(Deed deed, Report report);
}
