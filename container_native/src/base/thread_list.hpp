#pragma once

#include <dirent.h>
#include <fcntl.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <unistd.h>

#include <array>

namespace play_launch {

/// The threads of a process, without the allocator that opendir() needs.
class ThreadList {
 public:
  /// `folder` is /proc/<pid>/task.
  explicit ThreadList(const char* folder) noexcept
      : fd_(::open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {}
  ~ThreadList() {
    if (fd_ >= 0) {
      ::close(fd_);
    }
  }
  ThreadList(const ThreadList&) = delete;
  ThreadList& operator=(const ThreadList&) = delete;

  /// Calls visit(tid) for each. False when there is no list to be had.
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
        if (const pid_t thread = number(entry->d_name)) {
          visit(thread);
        }
        offset += entry->d_reclen;
      }
    }
  }

 private:
  using Entry = dirent64;

  static pid_t number(const char* text) noexcept {
    pid_t value = 0;
    for (; *text >= '0' && *text <= '9'; ++text) {
      value = value * 10 + (*text - '0');
    }
    return value;
  }

  int fd_;
};

}  // namespace play_launch
