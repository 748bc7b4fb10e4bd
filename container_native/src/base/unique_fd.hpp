#pragma once

#include <unistd.h>

#include <chrono>
#include <utility>

namespace play_launch {

/// Owns one file descriptor and closes it when it goes.
class UniqueFd {
 public:
  UniqueFd() = default;
  explicit UniqueFd(int fd) : fd_(fd) {}
  UniqueFd(UniqueFd&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  UniqueFd& operator=(UniqueFd&& other) noexcept {
    if (this != &other) {
      reset(std::exchange(other.fd_, -1));
    }
    return *this;
  }
  UniqueFd(const UniqueFd&) = delete;
  UniqueFd& operator=(const UniqueFd&) = delete;
  ~UniqueFd() { reset(); }

  int get() const { return fd_; }
  explicit operator bool() const { return fd_ >= 0; }

  /// Gives it away: it stays open.
  int release() { return std::exchange(fd_, -1); }

  void reset(int fd = -1) {
    if (fd_ >= 0) {
      ::close(fd_);
    }
    fd_ = fd;
  }

 private:
  int fd_ = -1;
};

/// Moves `fd` to a high number, which code of nodes that counts from 0 does not hit by chance: all
/// nodes share the container's table of descriptors. Returns that number and closes the old one;
/// where no number is free there, the descriptor stays where it is. Keeps errno.
int move_to_high_number(int fd) noexcept;

/// An eventfd to wake a thread with, at a high number. Throws std::system_error.
UniqueFd make_eventfd();

/// Wakes the threads that poll it. Any thread of any process that has it, also a signal handler.
void notify_eventfd(int fd) noexcept;

/// Forgets all notifications.
void clear_eventfd(int fd) noexcept;

/// Milliseconds that poll() has to wait for, rounded up; -1 for time_point::max().
int poll_timeout(std::chrono::steady_clock::time_point deadline) noexcept;

}  // namespace play_launch
