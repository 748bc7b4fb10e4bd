#include "base/unique_fd.hpp"

#include <fcntl.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <system_error>

namespace play_launch {
namespace {

/// The container's descriptors are among the last of the lowest 1024 numbers: low enough to keep
/// the kernel's table small, which fork() copies.
constexpr rlim_t kEnd = 1024;
constexpr rlim_t kRoom = 128;

}  // namespace

int move_to_high_number(int fd) noexcept {
  const int error = errno;
  rlimit limit{};
  const bool known = ::getrlimit(RLIMIT_NOFILE, &limit) == 0;
  const rlim_t end = std::min(known ? limit.rlim_cur : kEnd, kEnd);
  const int moved = end > kRoom ? ::fcntl(fd, F_DUPFD_CLOEXEC, static_cast<int>(end - kRoom)) : -1;
  if (moved >= 0) {
    ::close(fd);
  }
  errno = error;
  return moved >= 0 ? moved : fd;
}

UniqueFd make_eventfd() {
  const int fd = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (fd < 0) {
    throw std::system_error(errno, std::generic_category(), "eventfd");
  }
  return UniqueFd(move_to_high_number(fd));
}

void notify_eventfd(int fd) noexcept {
  const std::uint64_t one = 1;
  // Fails only when the counter is full, and then all waiters are awake anyway.
  [[maybe_unused]] const ssize_t written = ::write(fd, &one, sizeof one);
}

int poll_timeout(std::chrono::steady_clock::time_point deadline) noexcept {
  using std::chrono::steady_clock;
  constexpr std::int64_t kLongest = 1'000'000;
  if (deadline == steady_clock::time_point::max()) {
    return -1;
  }
  const auto now = steady_clock::now();
  if (deadline <= now) {
    return 0;  // it may be the smallest there is, which nothing can be subtracted from
  }
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - now);
  return static_cast<int>(std::min<std::int64_t>(left.count(), kLongest));
}

void clear_eventfd(int fd) noexcept {
  std::uint64_t count = 0;
  [[maybe_unused]] const ssize_t got = ::read(fd, &count, sizeof count);
}

}  // namespace play_launch
