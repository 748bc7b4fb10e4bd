#include "hosts/cloned/lock_watch.hpp"

#include <poll.h>
#include <pthread.h>

#include <algorithm>

#include "base/unique_fd.hpp"

namespace play_launch::container {
namespace {

using Clock = std::chrono::steady_clock;

}  // namespace

LockWatch::LockWatch() : begun_(make_eventfd()), done_(make_eventfd()) {
  thread_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "lock-watch");
    watch();
  });
}

LockWatch::~LockWatch() {
  notify_eventfd(done_.get());
  thread_.join();
}

void LockWatch::begin() noexcept { notify_eventfd(begun_.get()); }

std::vector<std::string> LockWatch::dead_locks() const {
  Found confirmed;
  {
    const std::lock_guard lock(mutex_);
    confirmed = confirmed_;
  }
  std::vector<std::string> lines;
  for (std::size_t i = 0; i < confirmed.count; ++i) {
    lines.push_back(describe(confirmed.locks[i]));
  }
  return lines;
}

void LockWatch::watch() noexcept {
  std::array<pollfd, 2> signalled{{{done_.get(), POLLIN, 0}, {begun_.get(), POLLIN, 0}}};
  while (::poll(signalled.data(), signalled.size(), -1) < 0) {
  }
  clear_eventfd(begun_.get());
  Clock::time_point last_death = Clock::now();
  Clock::time_point last_look = last_death;
  Found before;
  while (true) {
    const auto due = last_look + look_interval(Clock::now() - last_death);
    if (::poll(signalled.data(), signalled.size(), poll_timeout(due)) > 0) {
      if (signalled[0].revents != 0) {
        return;
      }
      clear_eventfd(begun_.get());
      last_death = Clock::now();
    } else if (Clock::now() >= due) {
      last_look = Clock::now();
      Found found;
      found.count = search_.look(found.locks);
      compare(before, found);
      before = found;
    }
  }
}

void LockWatch::compare(const Found& before, const Found& now) {
  const std::lock_guard lock(mutex_);
  confirmed_.count = 0;
  for (std::size_t i = 0; i < now.count; ++i) {
    const auto end = before.locks.begin() + before.count;
    if (std::any_of(before.locks.begin(), end, [&](const isolation::DeadLock& each) {
          return each.is_same_wait(now.locks[i]);
        })) {
      confirmed_.locks[confirmed_.count++] = now.locks[i];
    }
  }
}

}  // namespace play_launch::container
