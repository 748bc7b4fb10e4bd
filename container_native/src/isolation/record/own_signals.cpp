#include "isolation/record/own_signals.hpp"

#include <setjmp.h>
#include <signal.h>
#include <sys/syscall.h>
#include <time.h>
#include <ucontext.h>
#include <unistd.h>

#include <array>

namespace play_launch::isolation {

std::uint64_t exchange_signal_mask(std::uint64_t mask) noexcept {
  std::uint64_t before = 0;
  ::syscall(SYS_rt_sigprocmask, SIG_SETMASK, &mask, &before, sizeof mask);
  return before;
}

void block_all_signals() noexcept { exchange_signal_mask(~std::uint64_t{0}); }
void unblock_all_signals() noexcept { exchange_signal_mask(0); }

SelfSignal::SelfSignal(std::chrono::milliseconds limit, int signal, void* cookie,
                       clockid_t clock) noexcept {
  // Not through the C library, whose timer_create() may allocate.
  sigevent event{};
  event.sigev_notify = SIGEV_SIGNAL;
  event.sigev_signo = signal;
  event.sigev_value.sival_ptr = cookie;
  int timer = 0;
  if (::syscall(SYS_timer_create, clock, &event, &timer) != 0) {
    return;
  }
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(limit);
  itimerspec time{};
  time.it_value.tv_sec = seconds.count();
  time.it_value.tv_nsec = std::chrono::nanoseconds(limit - seconds).count();
  if (::syscall(SYS_timer_settime, timer, 0, &time, nullptr) == 0) {
    timer_ = timer;
  }
}

SelfSignal::~SelfSignal() {
  if (timer_ >= 0) {
    ::syscall(SYS_timer_delete, timer_);
  }
}

void signal_self_after(std::chrono::milliseconds limit, int signal, void* cookie,
                       clockid_t clock) noexcept {
  SelfSignal(limit, signal, cookie, clock).keep();
}

namespace {

bool ends_by_kill = false;

void set_default(int signal) noexcept {
  struct sigaction action{};
  action.sa_handler = SIG_DFL;
  ::sigaction(signal, &action, nullptr);
}

}  // namespace

void end_children_by_kill(bool enabled) noexcept { ends_by_kill = enabled; }
bool children_end_by_kill() noexcept { return ends_by_kill; }

void die_of(int signal) noexcept {
  block_all_signals();
  if (ends_by_kill) {
    ::syscall(SYS_kill, ::getpid(), SIGKILL);
  }
  set_default(signal);
  ::syscall(SYS_tgkill, ::getpid(), ::gettid(), signal);
  unblock_all_signals();
  constexpr int kExitSignalled = 128;  // as shells report it; for a signal that ends no process
  ::_exit(kExitSignalled + signal);
}

void die_in_place(int signal, siginfo_t& info, void* context) noexcept {
  set_default(signal);
  // Again as it came, instead of leaving it to the instruction to fault again: blocked while the
  // handler runs, it waits for the return.
  ::syscall(SYS_rt_tgsigqueueinfo, ::getpid(), ::gettid(), signal, &info);
  sigdelset(&static_cast<ucontext_t*>(context)->uc_sigmask, signal);
}

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
