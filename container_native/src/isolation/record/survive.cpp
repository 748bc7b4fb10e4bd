#include "isolation/record/survive.hpp"

#include <setjmp.h>
#include <unistd.h>

#include <array>

namespace play_launch::isolation {
namespace {

/// What a thread can cause in the midst of a function.
constexpr std::array kCaused{SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGTRAP, SIGSYS};

struct Attempt {
  sigjmp_buf place;
  Attempt* outer;
};

/// The innermost survive() of the thread.
thread_local constinit Attempt* current = nullptr;

bool was_caused_here(const siginfo_t& info) noexcept {
  return info.si_code > 0 || (info.si_code == SI_TKILL && info.si_pid == ::getpid());
}

}  // namespace

[[gnu::noinline]] bool survive(void (*function)(void*), void* argument) noexcept {
  Attempt attempt;
  attempt.outer = current;
  // With the signal mask, as the jump comes from a handler that blocks all.
  if (sigsetjmp(attempt.place, 1) != 0) {
    current = attempt.outer;
    return false;
  }
  current = &attempt;
  // A fault whose signal is blocked would end the process at once.
  sigset_t caused;
  sigset_t before;
  sigemptyset(&caused);
  for (const int signal : kCaused) {
    sigaddset(&caused, signal);
  }
  ::sigprocmask(SIG_UNBLOCK, &caused, &before);
  function(argument);
  ::sigprocmask(SIG_SETMASK, &before, nullptr);
  current = attempt.outer;
  return true;
}

bool is_surviving(const siginfo_t& info) noexcept {
  if (current == nullptr) {
    return false;
  }
  if (was_caused_here(info)) {
    siglongjmp(current->place, 1);
  }
  return true;
}

void forget_survival() noexcept { current = nullptr; }

}  // namespace play_launch::isolation
