#pragma once

#include <dirent.h>
#include <fcntl.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

namespace play_launch {

/// Names a process for good: process ids are used again, pairs with the start time are not.
struct ProcessIdentity {
  pid_t pid = 0;
  std::uint64_t start_time = 0;  // clock ticks after boot, /proc/<pid>/stat field 22; 0: unknown
};

/// Of any process whose /proc entry can be read. Async-signal-safe, as is the other.
ProcessIdentity identity_of(pid_t pid) noexcept;

/// The calling process's start time; 0 when /proc cannot be read.
std::uint64_t start_time_of_self() noexcept;

/// Whether a process is stopped, by a signal or by a debugger.
bool is_stopped(pid_t pid);

/// The path of the program that a process runs, if it is another one than this process's; nothing
/// when it is the same, or cannot be known.
std::optional<std::string> other_program_of(pid_t pid);

/// The calling process, and what it starts from now on, dumps no core when it dies of a signal; or,
/// with `dumps`, cores of any size that the hard limit of RLIMIT_CORE allows. Ignores errors when
/// that cannot be set. Async-signal-safe, keeps errno.
void set_core_dumps(bool dumps) noexcept;

/// When the supervisor is gone, so long may those of its processes run on that leave by themselves;
/// then spawn_guard kills them. Nothing of a session may live 1 s later. A killed process leaves
/// its shared memory behind, so one that leaves in order has to be gone before.
constexpr std::chrono::milliseconds kOrphanGrace{700};

/// Makes the heap of the calling thread large at once. glibc enlarges that of any thread but the
/// first page by page, and each time stops the others of the process at their page faults. Memory
/// that is not used stays free.
void grow_heap() noexcept;

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
