#pragma once

#include <rmw/types.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <ctime>
#include <deque>
#include <string>
#include <vector>

#include "topic_recorder/ros.hpp"
#include "topic_recorder/selection.hpp"
#include "topic_recorder/supervisor_link.hpp"

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

  /// When a message was received, of which the middleware may have the time by the system clock.
  [[nodiscard]] std::uint64_t received(const rmw_message_info_t& info) const {
    if (info.received_timestamp <= 0) {
      return now_ns();
    }
    const auto ago = static_cast<std::int64_t>(system_now_ns()) - info.received_timestamp;
    // Longer ago, or later than now, is a clock that was set in between.
    return now_ns() - static_cast<std::uint64_t>(ago > 0 && ago < kLongestAgo ? ago : 0);
  }

 private:
  static constexpr std::int64_t kLongestAgo = 60'000'000'000;
  std::int64_t offset_;
};

/// What comes on a topic that is measured.
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

/// The topics that are measured: each second it is reported what came.
class Measures {
 public:
  using Clock = std::chrono::steady_clock;

  Measures(const Options& options, const SessionClock& clock, SupervisorLink& link);

  /// Null when the topic is not measured; it stays where it is.
  Measure* find(const std::string& topic);
  /// Before all topics of the graph are noted.
  void forget_publishers();
  /// Takes over what the graph has of a topic.
  void note(const GraphTopic& found, const RosNode& node);
  /// When what has come is to be taken, and `report` called. Messages carry the time at which they
  /// arrived: to wake up for each would cost more than all else.
  [[nodiscard]] Clock::time_point due() const;
  /// Reports once a second.
  void report(Clock::time_point now);

 private:
  static constexpr std::chrono::milliseconds kBetweenLooks{100};
  static constexpr std::chrono::seconds kBetweenReports{1};

  void add(const std::string& topic);

  const Options& options_;
  const SessionClock& clock_;
  SupervisorLink& link_;
  std::deque<Measure> measures_;
  Clock::time_point looked_ = Clock::now();
  Clock::time_point reported_ = looked_;
};

}  // namespace play_launch::topics
