#pragma once

#include <chrono>
#include <functional>
#include <list>
#include <play_launch_msgs/msg/node_parameters.hpp>

#include "topic_recorder/asking_plan.hpp"
#include "topic_recorder/parameter_question.hpp"
#include "topic_recorder/ros.hpp"

namespace play_launch::topics {

/// Asks all nodes of the graph for their parameters, see AskingPlan.
class ParameterSurvey {
 public:
  using Time = AskingPlan::Time;
  using Parameters = play_launch_msgs::msg::NodeParameters;

  /// `answer_timeout` is how long a node may take for its answers.
  ParameterSurvey(RosNode& node, std::chrono::nanoseconds answer_timeout)
      : node_(node), answer_timeout_(answer_timeout), plan_(2 * answer_timeout) {}

  /// Looks which nodes there are.
  void follow_graph(Time now);
  /// Asks, and passes on what was answered or was not.
  void go_on(Time now, const std::function<void(Parameters)>& on_result);

  /// How many clients `add_to` adds.
  [[nodiscard]] std::size_t clients() const { return 2 * questions_.size(); }
  void add_to(WaitSet& wait_set) const;
  /// When `go_on` is to be called even though nothing has arrived.
  [[nodiscard]] Time due(Time now) const;

 private:
  std::optional<Parameters> result_of(ParameterQuestion& question, Time now);
  void begin(const std::string& name, Time now, const std::function<void(Parameters)>& on_result);
  void settle(Parameters result, Time now, const std::function<void(Parameters)>& on_result);

  RosNode& node_;
  const std::chrono::nanoseconds answer_timeout_;
  AskingPlan plan_;
  std::list<ParameterQuestion> questions_;
};

}  // namespace play_launch::topics
