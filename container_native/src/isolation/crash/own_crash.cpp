#include "isolation/crash/own_crash.hpp"

#include <poll.h>
#include <pthread.h>

#include <utility>

#include "base/unique_fd.hpp"
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

/// In the handler of the signal.
void have_it_reported() noexcept {
  has_crashed = true;
  notify_eventfd(wake);
  pollfd done{reported, POLLIN, 0};
  ::poll(&done, 1, kLimit);  // no signal can interrupt it: all are blocked
}

}  // namespace

OwnCrashWatch::OwnCrashWatch(Report report) : report_(std::move(report)) {
  wake = make_eventfd().release();
  reported = make_eventfd().release();
  thread_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "crash report");
    wait();
  });
  prepare_crash_handling();
  watch_own_crash(&slot, have_it_reported);
}

OwnCrashWatch::~OwnCrashWatch() {
  watch_own_crash(nullptr, nullptr);
  notify_eventfd(wake);
  thread_.join();
  // The eventfds stay open: a handler may be about to use them.
}

void OwnCrashWatch::wait() {
  pollfd woken{wake, POLLIN, 0};
  while (::poll(&woken, 1, -1) < 0) {
  }
  if (has_crashed) {
    survive([this] { report_(slot); });
    notify_eventfd(reported);
  }
}

}  // namespace play_launch::isolation
