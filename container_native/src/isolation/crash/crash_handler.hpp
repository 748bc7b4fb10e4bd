#pragma once

#include <signal.h>

#include <array>

#include "isolation/record/child_record.hpp"

namespace play_launch::isolation {

/// Once, in the container, before the first child and the first library of a node: notes what is
/// loaded by then, see prepare_code_map(), loads what handlers use and cannot load, and sets a
/// terminate handler that notes in a child's slot which exception it was.
void prepare_crash_handling();

/// In a child's first thread: installs its handlers.
///
/// SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGTRAP, SIGSYS, SIGXCPU and SIGXFSZ that the child
/// caused itself: the slot gets time, signal, address and program counter, then return addresses as
/// far as the stack is sound, the other threads are quiesced, and the child dies of that very
/// signal in the place where it happened, dumping core where that is on. A fault in the course of
/// this is survived. Any of these signals from another process, and from any process other signals
/// that end a process (SIGTERM, SIGINT, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2, SIGPWR, SIGIO, those of
/// timers), are a request: ChildProgram::cancel() is called, and the child dies of the signal when
/// run() returned or ChildOptions::leave_limit is over. Signals that the container ignores stay
/// ignored.
///
/// A node may install handlers of its own for all of them; they are its own process's.
void install_crash_handlers() noexcept;

/// In the process itself, which is no child: from now on the first of the same signals that it
/// causes itself is noted in the slot, as for a child, then `described` is called in the handler,
/// and the process dies of the signal. Null: no more.
void watch_own_crash(CrashSlot* slot, void (*described)() noexcept) noexcept;

/// While it exists, survive() holds outside of signal handlers, too, in the process itself: what
/// reports on a crash reads memory that the crash may have damaged. Other faults end the process as
/// they would without.
class SurvivalOfReports {
 public:
  SurvivalOfReports() noexcept;
  ~SurvivalOfReports();
  SurvivalOfReports(const SurvivalOfReports&) = delete;
  SurvivalOfReports& operator=(const SurvivalOfReports&) = delete;

 private:
  std::array<struct sigaction, 9> before_{};
};

/// In a child: makes the calling thread the one that ends it. If another one is at it already, this
/// one is parked for good.
void claim_end(ChildRecord& child) noexcept;

}  // namespace play_launch::isolation
