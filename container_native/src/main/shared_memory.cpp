#include "main/shared_memory.hpp"

#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdio>
#include <string_view>

namespace play_launch::container {
namespace {

// Fast DDS keeps a lock file open for every segment and port that a process owns:
// fastrtps_<name>_el beside fastrtps_<name>, and a semaphore sem.fastrtps_<name>_mutex.
constexpr std::string_view kPrefix = "/dev/shm/fastrtps_";
constexpr std::string_view kLockSuffix = "_el";
constexpr std::string_view kFolder = "/dev/shm/";

constexpr std::size_t kPathSize = 256;
constexpr rlim_t kMostDescriptors = 65536;

// No memory is allocated here, and no stdio stream used: the locks of both may be held by a thread
// that will never go on.
void unlink_formatted(const char* format, std::string_view name) noexcept {
  std::array<char, kPathSize> path{};
  const int length =
      std::snprintf(path.data(), path.size(), format, static_cast<int>(name.size()), name.data());
  if (length > 0 && static_cast<std::size_t>(length) < path.size()) {
    ::unlink(path.data());
  }
}

}  // namespace

void unlink_own_segments() noexcept {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) {
    return;
  }
  const int end = static_cast<int>(std::min(limit.rlim_cur, kMostDescriptors));
  for (int fd = 0; fd < end; ++fd) {
    std::array<char, kPathSize> link{};
    std::array<char, kPathSize> target{};
    std::snprintf(link.data(), link.size(), "/proc/self/fd/%d", fd);
    const ssize_t length = ::readlink(link.data(), target.data(), target.size());
    if (length <= 0 || static_cast<std::size_t>(length) >= target.size()) {
      continue;
    }
    const std::string_view lock(target.data(), static_cast<std::size_t>(length));
    if (!lock.starts_with(kPrefix) || !lock.ends_with(kLockSuffix)) {
      continue;
    }
    std::string_view name = lock.substr(kFolder.size());
    name.remove_suffix(kLockSuffix.size());
    unlink_formatted("/dev/shm/%.*s", name);
    unlink_formatted("/dev/shm/%.*s_sl", name);
    unlink_formatted("/dev/shm/sem.%.*s_mutex", name);
    unlink_formatted("/dev/shm/%.*s_el", name);
  }
}

}  // namespace play_launch::container
