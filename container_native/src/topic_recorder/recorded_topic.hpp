#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <ctime>
#include <memory>
#include <string>

#include "topic_recorder/measures.hpp"
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

}  // namespace play_launch::topics
