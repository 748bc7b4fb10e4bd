#pragma once

#include <sys/types.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "isolation/record/child_threads.hpp"

namespace play_launch::isolation {

/// A thread of the container, or of a child that matters, that waits without a time limit for a
/// lock which a dead child's thread holds: it will never wake up.
struct DeadLock {
  pid_t process = 0;
  pid_t thread = 0;
  std::array<char, 16> thread_name{};
  std::uintptr_t lock = 0;
  DeadThread holder;

  bool is_same_wait(const DeadLock& other) const {
    return thread == other.thread && lock == other.lock && holder.thread == other.holder.thread &&
           holder.process == other.holder.process;
  }
};

/// For users: waiter and owner.
std::string describe(const DeadLock& lock);

/// Finds them, from outside of the threads: what the kernel shows of the system call that a thread
/// sleeps in says which futex it waits for, and the lock there which thread took it. Reported are
/// only locks whose holder is known to have died with its child and has no living namesake: mutexes
/// of the C library (also std::mutex, std::recursive_mutex), and its read-write locks when a writer
/// held them (std::shared_mutex). Not seen: locks held by readers, spin locks, and conditions that
/// will never be signalled.
class DeadLockSearch {
 public:
  /// Throws std::system_error.
  DeadLockSearch();
  ~DeadLockSearch();
  DeadLockSearch(const DeadLockSearch&) = delete;
  DeadLockSearch& operator=(const DeadLockSearch&) = delete;

  /// Looks once; writes what it finds, as far as there is place, and returns how many that are.
  /// Neither allocates nor takes a lock.
  std::size_t look(std::span<DeadLock> found) noexcept;

 private:
  struct Wait;
  static std::optional<Wait> wait_of(pid_t process, pid_t thread) noexcept;
  pid_t holder_of(const Wait& wait) noexcept;
  template <class Lock>
  bool read(std::uintptr_t address, Lock& lock) noexcept;

  std::array<int, 2> pipe_{-1, -1};
};

}  // namespace play_launch::isolation
