#include "base/protected_descriptors.hpp"

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstddef>
#include <cstdint>

#include "base/number_list.hpp"

namespace play_launch {
namespace {

constexpr unsigned kNumbers = 4096;
constexpr unsigned kWordBits = 64;

/// The container's own descriptors are among the last of as many numbers: high enough for code
/// counts from 0, low enough to keep the kernel's table small, which fork() copies.
constexpr rlim_t kReach = 1024;
constexpr rlim_t kRoom = 128;

struct File {
  std::atomic<dev_t> device{0};
  std::atomic<ino_t> inode{0};
};

std::array<std::atomic<std::uint64_t>, kNumbers / kWordBits> bits{};
std::array<File, kNumbers> files;
std::atomic<pid_t> owner{0};

constexpr std::uint64_t bit_of(unsigned number) { return std::uint64_t{1} << (number % kWordBits); }

bool is_marked(unsigned number) {
  return number < kNumbers && (bits[number / kWordBits] & bit_of(number)) != 0;
}

void unmark(unsigned number) { bits[number / kWordBits] &= ~bit_of(number); }

void mark(int fd) noexcept {
  const auto number = static_cast<unsigned>(fd);
  struct stat status{};
  if (number >= kNumbers || ::fstat(fd, &status) != 0) {
    return;
  }
  owner = ::getpid();
  files[number].device = status.st_dev;
  files[number].inode = status.st_ino;
  bits[number / kWordBits] |= bit_of(number);
}

class KeptErrno {
 public:
  KeptErrno() noexcept : error_(errno) {}
  ~KeptErrno() { errno = error_; }
  KeptErrno(const KeptErrno&) = delete;
  KeptErrno& operator=(const KeptErrno&) = delete;

 private:
  int error_;
};

}  // namespace

int move_out_of_reach(int fd) noexcept {
  const KeptErrno kept;
  rlimit limit{};
  const bool known = ::getrlimit(RLIMIT_NOFILE, &limit) == 0;
  const rlim_t end = std::min(known ? limit.rlim_cur : kReach, kReach);
  const int moved = end > kRoom ? ::fcntl(fd, F_DUPFD_CLOEXEC, static_cast<int>(end - kRoom)) : -1;
  if (moved < 0) {
    mark(fd);
    return fd;
  }
  mark(moved);
  ::close(fd);
  return moved;
}

void protect_open_descriptors() noexcept {
  const KeptErrno kept;
  NumberList open("/proc/self/fd");
  open.for_each([&open](int fd) {
    if (fd != open.descriptor()) {
      mark(fd);
    }
  });
}

bool is_protected(int fd) noexcept {
  const auto number = static_cast<unsigned>(fd);
  if (!is_marked(number)) {
    return false;
  }
  const KeptErrno kept;
  struct stat status{};
  if (::fstat(fd, &status) == 0 && status.st_dev == files[number].device &&
      status.st_ino == files[number].inode) {
    return true;
  }
  if (protects_descriptors()) {
    unmark(number);
  }
  return false;
}

bool is_any_protected(unsigned first, unsigned last) noexcept {
  for (unsigned number = first; number <= last && number < kNumbers; ++number) {
    if (is_protected(static_cast<int>(number))) {
      return true;
    }
  }
  return false;
}

bool may_be_protected(int fd) noexcept { return is_marked(static_cast<unsigned>(fd)); }

void release_protection(int fd) noexcept {
  if (may_be_protected(fd)) {
    unmark(static_cast<unsigned>(fd));
  }
}

bool protects_descriptors() noexcept { return ::getpid() == owner; }

}  // namespace play_launch
