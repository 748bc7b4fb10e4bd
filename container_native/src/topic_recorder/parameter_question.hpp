#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <play_launch_msgs/msg/node_parameters.hpp>
#include <rcl_interfaces/srv/get_parameters.hpp>
#include <rcl_interfaces/srv/list_parameters.hpp>
#include <string>
#include <vector>

#include "topic_recorder/ros.hpp"

namespace play_launch::topics {

/// Asks one node which parameters it has, and then what they are.
class ParameterQuestion {
 public:
  using Time = std::chrono::steady_clock::time_point;
  using Parameters = play_launch_msgs::msg::NodeParameters;

  /// `until` is when it gives up. Throws std::runtime_error.
  ParameterQuestion(RosNode& node, const std::string& name, Time until);

  [[nodiscard]] const std::string& name() const { return result_.node; }
  /// Until when there will be an answer, or an error.
  [[nodiscard]] Time until() const { return until_; }
  /// Whether its services are still to be found, of which the middleware gives no notice.
  [[nodiscard]] bool is_looking() const { return step_ == Step::find; }
  void add_to(WaitSet& wait_set) const;

  /// Goes as far as it can; the result once there is one. Throws std::runtime_error.
  std::optional<Parameters> go_on(Time now);

 private:
  enum class Step { find, list, get };

  void answer(const std::vector<rcl_interfaces::msg::ParameterValue>& values);

  ServiceClient list_;
  ServiceClient get_;
  const Time until_;
  Step step_ = Step::find;
  std::int64_t request_ = 0;
  std::vector<std::string> names_;
  Parameters result_;
};

}  // namespace play_launch::topics
