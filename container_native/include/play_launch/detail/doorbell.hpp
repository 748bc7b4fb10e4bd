#pragma once

#include <atomic>
#include <cstdint>
#include <limits>

namespace play_launch {

/// Points in time are nanoseconds of the steady clock (CLOCK_MONOTONIC).
using Nanoseconds = std::int64_t;
inline constexpr Nanoseconds kAtOnce = std::numeric_limits<Nanoseconds>::min();
inline constexpr Nanoseconds kNever = std::numeric_limits<Nanoseconds>::max();

namespace detail {

/// A counter that threads can wait on. It holds no state that a thread which dies while waiting
/// could leave locked, unlike a condition variable: executors work in processes that share their
/// memory with others and may be killed at any time.
class Doorbell {
 public:
  /// The number to hand to wait(). Read it before looking for work.
  [[nodiscard]] std::uint32_t rings() const noexcept { return rings_.load(); }

  /// Wakes one waiter, or all. Async-signal-safe.
  void ring() noexcept { ring(1); }
  void ring_all() noexcept { ring(std::numeric_limits<int>::max()); }

  /// Returns when it rang since `seen` was read, at `deadline`, or for no reason.
  void wait(std::uint32_t seen, Nanoseconds deadline = kNever) noexcept;

 private:
  void ring(int waiters) noexcept;

  std::atomic<std::uint32_t> rings_{0};
  std::atomic<std::uint32_t> waiters_{0};
};

}  // namespace detail
}  // namespace play_launch
