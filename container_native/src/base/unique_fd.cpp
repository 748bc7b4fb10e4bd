#include "base/unique_fd.hpp"

#include <fcntl.h>
#include <sys/resource.h>

#include <algorithm>
#include <cerrno>

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

}  // namespace play_launch
