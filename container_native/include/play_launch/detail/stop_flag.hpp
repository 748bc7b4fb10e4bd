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

/// The request to an executor to stop, final once made. It belongs to the code that may make the
/// request, and the executor is given a share in it: the request can be made at any time, also
/// before the executor exists and after it was destroyed, and neither side waits for the other.
class StopFlag {
 public:
  /// Makes the request. Any thread; async-signal-safe.
  void set() noexcept {
    set_.store(true);
    doorbell_.ring_all();
  }
  [[nodiscard]] bool is_set() const noexcept { return set_.load(); }

  /// Returns when the request has been made.
  void wait() noexcept;

  /// Rings with the request; the executor may wait there for its work as well.
  [[nodiscard]] Doorbell& doorbell() noexcept { return doorbell_; }

 private:
  static_assert(std::atomic<bool>::is_always_lock_free);

  std::atomic<bool> set_{false};
  Doorbell doorbell_;
};

}  // namespace detail
}  // namespace play_launch
