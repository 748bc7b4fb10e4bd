#pragma once

#include <array>
#include <cstddef>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "base/unique_fd.hpp"
#include "isolation/after/dead_locks.hpp"

namespace play_launch::container {

/// Looks, from the first death of a node on, twice a second for threads that wait for a lock which
/// a dead one holds. In a thread of its own, which neither allocates nor takes a lock that nodes
/// could hold.
class LockWatch {
 public:
  /// Throws std::system_error.
  LockWatch();
  ~LockWatch();
  LockWatch(const LockWatch&) = delete;
  LockWatch& operator=(const LockWatch&) = delete;

  /// A node has died. Any thread, also a donor.
  void begin() noexcept;

  /// Those that were found twice in a row, in words.
  std::vector<std::string> dead_locks() const;

 private:
  static constexpr std::size_t kMost = 16;

  /// The result of one look.
  struct Found {
    std::array<isolation::DeadLock, kMost> locks{};
    std::size_t count = 0;
  };

  void watch() noexcept;
  void compare(const Found& before, const Found& now);

  isolation::DeadLockSearch search_;
  const UniqueFd begun_;
  const UniqueFd done_;
  mutable std::mutex mutex_;  // guards what follows
  Found confirmed_;
  std::thread thread_;  // last: it uses all of the above
};

}  // namespace play_launch::container
