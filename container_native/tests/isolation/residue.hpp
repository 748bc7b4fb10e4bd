#pragma once

/// A library whose code leaves something with the thread that calls it.

/// What the destructor does after it has told: nothing, or what a broken one does.
enum class Deed { nothing, fault, raise, loop, another };

/// Where destructors tell that they run: a counter of the test's, for each process.
using Told = void (*)();

extern "C" {
/// A thread_local object. `another`: its destructor makes one more.
void leave_object(Deed deed, Told told);
/// A value of a pthread key. `another`: it comes back for ever.
void leave_value(Deed deed, Told told);
}
