#include "fastdds/segments.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstddef>
#include <string_view>

#include "base/process.hpp"

namespace play_launch {
namespace {

// Fast DDS keeps a lock file open for every segment and port that a process owns:
// fastrtps_<name>_el beside fastrtps_<name>, and a semaphore sem.fastrtps_<name>_mutex. From
// version 3 on fastdds_ takes the place of fastrtps_.
constexpr std::string_view kPrefix = "/dev/shm/fastrtps_";
constexpr std::string_view kNewPrefix = "/dev/shm/fastdds_";
constexpr std::string_view kLockSuffix = "_el";
constexpr std::string_view kFolder = "/dev/shm/";

constexpr std::size_t kPathSize = 256;

/// A path in memory of its own. No memory is allocated here, and nothing of stdio used: the locks
/// of both may be held by a thread that will never go on.
class Path {
 public:
  Path& operator<<(std::string_view text) noexcept {
    const std::size_t size = std::min(text.size(), kPathSize - 1 - size_);
    is_whole_ = is_whole_ && size == text.size();
    std::ranges::copy(text.substr(0, size), text_.begin() + static_cast<std::ptrdiff_t>(size_));
    size_ += size;
    return *this;
  }
  Path& operator<<(int number) noexcept {
    std::array<char, 12> digits{};
    const auto end = std::to_chars(digits.begin(), digits.end(), number).ptr;
    return *this << std::string_view(digits.begin(), end);
  }
  bool is_whole() const noexcept { return is_whole_; }
  const char* c_str() const noexcept { return text_.data(); }

 private:
  std::array<char, kPathSize> text_{};
  std::size_t size_ = 0;
  bool is_whole_ = true;
};

void unlink_in_folder(std::string_view before, std::string_view name,
                      std::string_view after) noexcept {
  Path path;
  path << kFolder << before << name << after;
  if (path.is_whole()) {
    ::unlink(path.c_str());
  }
}

}  // namespace

void unlink_own_segments() noexcept {
  NumberList("/proc/self/fd").for_each([](int fd) {
    Path link;
    link << "/proc/self/fd/" << fd;
    std::array<char, kPathSize> target{};
    const ssize_t length = ::readlink(link.c_str(), target.data(), target.size());
    if (length <= 0 || static_cast<std::size_t>(length) >= target.size()) {
      return;
    }
    const std::string_view lock(target.data(), static_cast<std::size_t>(length));
    const bool is_theirs = lock.starts_with(kPrefix) || lock.starts_with(kNewPrefix);
    if (!is_theirs || !lock.ends_with(kLockSuffix)) {
      return;
    }
    std::string_view name = lock.substr(kFolder.size());
    name.remove_suffix(kLockSuffix.size());
    unlink_in_folder("", name, "");
    unlink_in_folder("", name, "_sl");
    unlink_in_folder("sem.", name, "_mutex");
    unlink_in_folder("", name, "_el");
  });
}

}  // namespace play_launch
