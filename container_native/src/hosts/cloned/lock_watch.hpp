#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "base/unique_fd.hpp"
#include "isolation/after/dead_locks.hpp"

namespace play_launch::container {

/// How long to wait between two looks, when the last death of a node was so long ago.
constexpr std::chrono::milliseconds look_interval(std::chrono::nanoseconds since_death) {
  using namespace std::chrono_literals;
  return since_death < 1min ? 500ms : 2000ms;
}

/// Looks, from the first death of a node on, for threads that wait for a lock which a dead one
/// holds: twice a second, and every 2 s when no node has died for a minute. In a thread of its own,
/// which neither allocates nor takes a lock that nodes could hold; which ones these are, and what
/// becomes of them, is listed in docs/isolation.md.
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
