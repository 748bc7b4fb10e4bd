#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <ctime>
#include <memory>
#include <string>

#include "topic_recorder/ros.hpp"
#include "topic_recorder/selection.hpp"

namespace play_launch::topics {

/// So many bytes per second, and what was not used of the last second. A message larger than a
/// second's bytes passes when a whole second's are there; those after it pay for it.
class ByteBudget {
 public:
  /// 0 for no limit.
  explicit ByteBudget(std::uint64_t per_second) : per_second_(static_cast<double>(per_second)) {
    left_ = per_second_;
  }

  /// Whether a message may pass; `now` is in nanoseconds of any clock that does not go back.
  bool spend(std::uint64_t bytes, std::int64_t now) {
    if (per_second_ <= 0) {
      return true;
    }
    if (now > last_) {
      left_ = std::min(per_second_, left_ + per_second_ * 1e-9 * static_cast<double>(now - last_));
      last_ = now;
    }
    const auto size = static_cast<double>(bytes);
    if (left_ < std::min(size, per_second_)) {
      return false;
    }
    left_ -= size;
    return true;
  }

 private:
  double per_second_;
  double left_;
  std::int64_t last_ = 0;
};

/// What comes on a topic of which it is reported.
struct Measure {
  std::string topic;
  std::string types;
  std::uint32_t publishers = 0;
  std::uint32_t reliable = 0;
  std::uint32_t latched = 0;
  std::uint64_t messages = 0;
  /// Nanoseconds between two messages, at most.
  std::uint64_t gap = 0;
  /// When the latest message came, or measuring began, by the session's clock.
  std::uint64_t latest = 0;

  void note(std::uint64_t received) {
    ++messages;
    gap = std::max(gap, received - std::min(received, latest));
    latest = std::max(latest, received);
  }
};

/// A topic that is recorded, held or measured.
struct RecordedTopic {
  std::string name;
  std::string type;
  Treatment treatment = Treatment::none;
  const rosidl_message_type_support_t* type_support = nullptr;
  ByteBudget budget;
  /// What a subscription asks for.
  rmw_qos_profile_t request;
  /// Null until the supervisor has given a channel to what is kept, and when it failed.
  std::unique_ptr<SerializedSubscription> subscription = nullptr;
  /// Null when nothing of it is reported.
  Measure* measure = nullptr;
  std::uint16_t channel = 0;
  /// Counts what is not recorded as well, so that a reader sees the gap.
  std::uint32_t sequence = 0;
  /// Of its latest message, in nanoseconds since the epoch.
  std::uint64_t log_time = 0;
  std::uint64_t over_budget = 0;
  std::uint64_t without_room = 0;
};

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

  /// When a message was received, of which the middleware may have the time by the system clock.
  [[nodiscard]] std::uint64_t received(const rmw_message_info_t& info) const {
    if (info.received_timestamp <= 0) {
      return now_ns();
    }
    const auto ago = static_cast<std::int64_t>(system_now_ns()) - info.received_timestamp;
    // Longer ago is a clock that was set in between.
    return now_ns() - static_cast<std::uint64_t>(std::clamp(ago, std::int64_t{0}, kLongestAgo));
  }

 private:
  static constexpr std::int64_t kLongestAgo = 60'000'000'000;
  std::int64_t offset_;
};

}  // namespace play_launch::topics
