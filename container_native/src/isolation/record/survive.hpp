#pragma once

#include <signal.h>

namespace play_launch::isolation {

/// Runs function(argument), in a signal handler that install_crash_handlers() or
/// install_park_handler() installed, or while there is a SurvivalOfReports. A fault or an abort()
/// in it ends the function where it is, and nothing else; false then. What it had taken (memory,
/// locks, descriptors) stays taken. Calls may be nested. Async-signal-safe.
bool survive(void (*function)(void*), void* argument) noexcept;

template <class Function>
bool survive(Function function) noexcept {
  return survive([](void* argument) { (*static_cast<Function*>(argument))(); }, &function);
}

/// First thing in the handler of such a signal: does not return when the calling thread is within
/// survive() and caused the signal. True when it is within survive() and did not: then the signal
/// comes too late to be obeyed.
bool is_surviving(const siginfo_t& info) noexcept;

/// The calling thread is in no survive(), whatever a dead one left behind in its storage.
void forget_survival() noexcept;

}  // namespace play_launch::isolation
