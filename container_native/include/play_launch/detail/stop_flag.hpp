#pragma once

#include <atomic>
#include <play_launch/detail/doorbell.hpp>

namespace play_launch::detail {

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

}  // namespace play_launch::detail
