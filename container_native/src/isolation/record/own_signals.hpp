#pragma once

#include <signal.h>
#include <time.h>

#include <chrono>
#include <cstdint>

namespace play_launch::isolation {

/// The calling thread's mask of blocked signals in the kernel's format, one bit a signal; replaced
/// by `mask`. Past the C library, which never blocks the signals that it keeps for itself.
/// Async-signal-safe, as are the others.
std::uint64_t exchange_signal_mask(std::uint64_t mask) noexcept;

/// Sets the calling thread's mask of blocked signals to all of them (including those that the C
/// library keeps for itself) or none.
void block_all_signals() noexcept;
void unblock_all_signals() noexcept;

/// A signal to the calling process after so long, unless this is destroyed before. For a handler,
/// si_code is SI_TIMER then, and si_ptr the cookie. The clock is one of timer_create()'s, such as
/// CLOCK_PROCESS_CPUTIME_ID. Async-signal-safe.
class SelfSignal {
 public:
  SelfSignal(std::chrono::milliseconds limit, int signal, void* cookie = nullptr,
             clockid_t clock = CLOCK_MONOTONIC) noexcept;
  ~SelfSignal();
  SelfSignal(const SelfSignal&) = delete;
  SelfSignal& operator=(const SelfSignal&) = delete;

  /// It comes whether this is destroyed or not.
  void keep() noexcept { timer_ = -1; }

 private:
  int timer_ = -1;
};

/// In a child: such a signal that always comes, if there is a timer to be had.
void signal_self_after(std::chrono::milliseconds limit, int signal, void* cookie = nullptr,
                       clockid_t clock = CLOCK_MONOTONIC) noexcept;

/// Before Linux 5.16, a process whose signal dumps core takes along all that share its memory, even
/// where no core would be written. With true, children end by SIGKILL in place of any signal.
/// To be called before the first child.
void end_children_by_kill(bool enabled) noexcept;
bool children_end_by_kill() noexcept;

/// In a child: ends it by that signal's default action, or by SIGKILL in place of it.
[[noreturn]] void die_of(int signal) noexcept;

/// From a handler that blocks all signals: the process dies of the signal when the handler returns,
/// in the interrupted place and with the interrupted registers, so that a core shows the fault and
/// not the handler.
void die_in_place(int signal, siginfo_t& info, void* context) noexcept;

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
