#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "topic_recorder/byte_budget.hpp"
#include "topic_recorder/ros.hpp"
#include "topic_recorder/selection.hpp"

namespace play_launch::topics {

/// A topic that is recorded or held.
struct RecordedTopic {
  std::string name;
  std::string type;
  Treatment treatment = Treatment::none;
  const rosidl_message_type_support_t* type_support = nullptr;
  ByteBudget budget;
  /// What a subscription asks for.
  rmw_qos_profile_t request;
  /// Null until the supervisor has given it a channel, and when it failed.
  std::unique_ptr<SerializedSubscription> subscription = nullptr;
  std::uint16_t channel = 0;
  /// Counts what is not recorded as well, so that a reader sees the gap.
  std::uint32_t sequence = 0;
  /// Of its latest message, in nanoseconds since the epoch.
  std::uint64_t log_time = 0;
  std::uint64_t over_budget = 0;
  std::uint64_t without_room = 0;
};

}  // namespace play_launch::topics
