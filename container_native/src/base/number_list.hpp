#pragma once

#include <dirent.h>
#include <fcntl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>

namespace play_launch {

/// The numbers that a folder of /proc lists: the threads in task, the descriptors in fd. Without
/// the allocator that opendir() needs; async-signal-safe.
class NumberList {
 public:
  /// `folder` is /proc/<pid>/task or /proc/<pid>/fd.
  explicit NumberList(const char* folder) noexcept
      : fd_(::open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {}
  ~NumberList() {
    if (fd_ >= 0) {
      ::close(fd_);
    }
  }
  NumberList(const NumberList&) = delete;
  NumberList& operator=(const NumberList&) = delete;

  /// Calls visit(number) for each. False when there is no list to be had.
  template <class Visit>
  bool for_each(Visit visit) noexcept {
    if (fd_ < 0 || ::lseek(fd_, 0, SEEK_SET) != 0) {
      return false;
    }
    alignas(Entry) std::array<char, 4096> buffer;
    while (true) {
      const long size = ::syscall(SYS_getdents64, fd_, buffer.data(), buffer.size());
      if (size <= 0) {
        return size == 0;
      }
      for (long offset = 0; offset < size;) {
        const auto* const entry = reinterpret_cast<const Entry*>(buffer.data() + offset);
        if (entry->d_name[0] != '.') {
          visit(number(entry->d_name));
        }
        offset += entry->d_reclen;
      }
    }
  }

  /// Its own descriptor, which is in the list when that is of the own process's descriptors.
  int descriptor() const { return fd_; }

 private:
  using Entry = dirent64;

  static int number(const char* text) noexcept {
    int value = 0;
    for (; *text >= '0' && *text <= '9'; ++text) {
      value = value * 10 + (*text - '0');
    }
    return value;
  }

  int fd_;
};

}  // namespace play_launch
