#include "isolation/crash/own_crash.hpp"

#include <poll.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <system_error>
#include <utility>

#include "isolation/crash/crash_handler.hpp"
#include "isolation/record/own_signals.hpp"

namespace play_launch::isolation {
namespace {

/// Milliseconds that a dying thread waits for its report.
constexpr int kLimit = 1000;

// For a signal handler, which may run while all else is being taken apart.
CrashSlot slot;
int wake = -1;
int reported = -1;
bool has_crashed = false;

void ring(int bell) noexcept {
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = ::write(bell, &one, sizeof one);
}

/// In the handler of the signal.
void have_it_reported() noexcept {
  has_crashed = true;
  ring(wake);
  pollfd done{reported, POLLIN, 0};
  ::poll(&done, 1, kLimit);  // no signal can interrupt it: all are blocked
}

int new_bell() {
  const int bell = ::eventfd(0, EFD_CLOEXEC);
  if (bell < 0) {
    throw std::system_error(errno, std::generic_category(), "eventfd");
  }
  return bell;
}

}  // namespace

OwnCrashWatch::OwnCrashWatch(Report report) : report_(std::move(report)) {
  wake = new_bell();
  reported = new_bell();
  thread_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "crash report");
    wait();
  });
  prepare_crash_handling();
  watch_own_crash(&slot, have_it_reported);
}

OwnCrashWatch::~OwnCrashWatch() {
  watch_own_crash(nullptr, nullptr);
  ring(wake);
  thread_.join();
  // The bells stay open: a handler may be about to use them.
}

void OwnCrashWatch::wait() {
  pollfd woken{wake, POLLIN, 0};
  while (::poll(&woken, 1, -1) < 0) {
  }
  if (has_crashed) {
    survive([this] { report_(slot); });
    ring(reported);
  }
}

}  // namespace play_launch::isolation
