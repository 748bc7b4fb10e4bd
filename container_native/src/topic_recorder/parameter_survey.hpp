#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <play_launch_msgs/msg/node_parameters.hpp>
#include <rcl_interfaces/srv/get_parameters.hpp>
#include <rcl_interfaces/srv/list_parameters.hpp>
#include <set>
#include <string>
#include <vector>

#include "topic_recorder/chunk.hpp"
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

/// Puts what a node answered into a chunk, to be appended there; returns its size in bytes, or
/// nothing when it cannot be serialised. `now` is in nanoseconds since the epoch.
std::optional<std::size_t> put(play_launch_msgs::msg::NodeParameters parameters, std::uint64_t now,
                               ChunkBuilder& chunk);

/// Asks all nodes of the graph for their parameters: each once in each of its lives, and slowly.
class ParameterSurvey {
 public:
  using Time = ParameterQuestion::Time;
  using Parameters = ParameterQuestion::Parameters;
  using OnResult = std::function<void(Parameters)>;

  /// `answer_timeout` is how long a node may take for its answers.
  ParameterSurvey(RosNode& node, std::chrono::nanoseconds answer_timeout)
      : node_(node), answer_timeout_(answer_timeout) {}

  /// Looks which nodes there are.
  void follow_graph(Time now);
  /// Asks, and passes on what was answered. That a node does not answer is passed on when it has
  /// failed twice, or is gone; it is asked again and again, ever more rarely.
  void go_on(Time now, const OnResult& on_result);

  /// How many clients `add_to` adds.
  [[nodiscard]] std::size_t clients() const { return 2 * asked_; }
  void add_to(WaitSet& wait_set) const;
  /// When `go_on` is to be called even though nothing has arrived.
  [[nodiscard]] Time due(Time now) const;

 private:
  struct Entry {
    std::set<AskableNode::Life> lives;
    /// When it is to be asked; Time::max() once it has answered.
    Time due{};
    int failures = 0;
    /// It was found anew while it was asked.
    bool again = false;
    bool gone = false;
    /// While it is asked.
    std::unique_ptr<ParameterQuestion> question = nullptr;
  };

  [[nodiscard]] bool may_ask() const;
  static void begin(Entry& entry, Time now);
  std::optional<Parameters> ask(const std::string& name, Entry& entry, Time now);
  void settle(Entry& entry, Parameters result, Time now, const OnResult& on_result);

  RosNode& node_;
  const std::chrono::nanoseconds answer_timeout_;
  std::map<std::string, Entry> entries_;
  std::size_t asked_ = 0;
  Time not_before_{};
};

}  // namespace play_launch::topics
