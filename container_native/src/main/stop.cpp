#include "main/stop.hpp"

#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <unistd.h>

#include <cerrno>

#include "base/report.hpp"
#include "base/unique_fd.hpp"
#include "fastdds/segments.hpp"

namespace play_launch::container {
namespace {

constexpr int kSignalsToLeaveAtOnce = 3;
constexpr int kSignalExitBase = 128;

// What a signal handler may touch.
volatile sig_atomic_t signal_event_fd = -1;
volatile pid_t container_pid = 0;
std::atomic<int> signals{0};
static_assert(std::atomic<int>::is_always_lock_free);

extern "C" void on_stop_signal(int number) {
  const int error = errno;
  if (signals.fetch_add(1) + 1 >= kSignalsToLeaveAtOnce) {
    if (::getpid() != container_pid) {
      // A helper that a node forked without exec: the segments are the container's.
      ::_exit(kSignalExitBase + number);
    }
    leave_now(kSignalExitBase + number);
  }
  notify_eventfd(signal_event_fd);
  errno = error;
}

extern "C" void on_ignored_signal(int) {}

void set_handler(int number, void (*handler)(int)) {
  struct sigaction action{};
  action.sa_handler = handler;
  action.sa_flags = SA_RESTART;
  sigemptyset(&action.sa_mask);
  ::sigaction(number, &action, nullptr);
}

bool is_ignored(int number) {
  struct sigaction action{};
  ::sigaction(number, nullptr, &action);
  return action.sa_handler == SIG_IGN;
}

}  // namespace

StopRequests::StopRequests() : event_(make_eventfd()) {}

void StopRequests::handle_signals() {
  signal_event_fd = event_.get();
  container_pid = ::getpid();
  set_handler(SIGINT, on_stop_signal);
  set_handler(SIGTERM, on_stop_signal);
  if (!is_ignored(SIGHUP)) {
    set_handler(SIGHUP, on_stop_signal);
  }
  // A handler instead of SIG_IGN: programs that nodes start would inherit SIG_IGN, but get the
  // default back where a handler was.
  set_handler(SIGPIPE, on_ignored_signal);
  sigset_t ours;
  sigemptyset(&ours);
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) {
    sigaddset(&ours, number);
  }
  ::pthread_sigmask(SIG_UNBLOCK, &ours, nullptr);
}

void StopRequests::request(StopCause cause, const std::string& why) {
  ++requests_;
  {
    const std::lock_guard lock(mutex_);
    if (cause_ == StopCause::none) {
      why_ = why;
      cause_ = cause;
    }
  }
  wake();
}

void StopRequests::wake() { notify_eventfd(event_.get()); }

void StopRequests::wait(SteadyTime deadline) {
  pollfd fd{event_.get(), POLLIN, 0};
  if (::poll(&fd, 1, poll_timeout(deadline)) > 0) {
    clear_eventfd(event_.get());
  }
}

StopCause StopRequests::cause() const {
  const StopCause cause = cause_;
  return cause == StopCause::none && signals > 0 ? StopCause::signal : cause;
}

std::string StopRequests::why() const {
  const std::lock_guard lock(mutex_);
  return why_;
}

int StopRequests::times_asked() const { return requests_ + signals; }

Watchdog::Watchdog()
    : thread_([this] {
        ::pthread_setname_np(::pthread_self(), "watchdog");
        watch();
      }) {}

Watchdog::~Watchdog() {
  {
    const std::lock_guard lock(mutex_);
    done_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void Watchdog::arm(SteadyTime deadline, int exit_code, const std::string& what) {
  {
    const std::lock_guard lock(mutex_);
    if (deadline >= deadline_) {
      return;
    }
    deadline_ = deadline;
    exit_code_ = exit_code;
    what_ = what;
  }
  changed_.notify_all();
}

void Watchdog::watch() {
  std::unique_lock lock(mutex_);
  while (!done_) {
    if (deadline_ == SteadyTime::max()) {
      changed_.wait(lock);
    } else if (std::chrono::steady_clock::now() >= deadline_) {
      report(what_);
      leave_now(exit_code_);
    } else {
      changed_.wait_until(lock, SteadyTime(deadline_));
    }
  }
}

void leave_now(int exit_code) noexcept {
  unlink_own_segments();
  ::_exit(exit_code);
}

}  // namespace play_launch::container
