#include "hosts/cloned/lock_watch.hpp"

#include <poll.h>
#include <pthread.h>

#include <algorithm>

#include "base/doorbell.hpp"

namespace play_launch::container {
namespace {

constexpr int kInterval = 500;  // milliseconds

}  // namespace

LockWatch::LockWatch() : begun_(make_doorbell()), done_(make_doorbell()) {
  thread_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "lock-watch");
    watch();
  });
}

LockWatch::~LockWatch() {
  ring(done_.get());
  thread_.join();
}

void LockWatch::begin() noexcept { ring(begun_.get()); }

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
  std::array<pollfd, 2> rung{{{done_.get(), POLLIN, 0}, {begun_.get(), POLLIN, 0}}};
  while (::poll(rung.data(), rung.size(), -1) < 0) {
  }
  Found before;
  while (::poll(rung.data(), 1, kInterval) <= 0) {
    Found now;
    now.count = search_.look(now.locks);
    compare(before, now);
    before = now;
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
