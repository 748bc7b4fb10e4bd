#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <ctime>

namespace play_launch::topics {

/// Nanoseconds since the epoch by the system clock.
inline std::uint64_t system_now_ns() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return static_cast<std::uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(now).count());
}

/// The clock of the session, which gives the log times: it goes on evenly when the system clock is
/// set. `play_launch/recording/clock.py` has the same.
class SessionClock {
 public:
  /// The offset is added to the time since boot.
  explicit SessionClock(std::int64_t offset) : offset_(offset) {}

  [[nodiscard]] std::uint64_t now_ns() const {
    timespec now{};
    clock_gettime(CLOCK_BOOTTIME, &now);
    return static_cast<std::uint64_t>(now.tv_sec * std::int64_t{1'000'000'000} + now.tv_nsec +
                                      offset_);
  }

  /// When a message was received, of which the middleware has the time by the system clock.
  [[nodiscard]] std::uint64_t received(std::int64_t timestamp) const {
    const auto ago = static_cast<std::int64_t>(system_now_ns()) - timestamp;
    // Longer ago is a clock that was set in between.
    return now_ns() - static_cast<std::uint64_t>(std::clamp(ago, std::int64_t{0}, kLongestAgo));
  }

 private:
  static constexpr std::int64_t kLongestAgo = 60'000'000'000;
  std::int64_t offset_;
};

}  // namespace play_launch::topics
