#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <list>
#include <map>
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

/// Which node is asked for its parameters when: each once in each of its lives, and slowly.
class AskingPlan {
 public:
  using Time = std::chrono::steady_clock::time_point;

  /// How long a node is left alone after it was found.
  static constexpr std::chrono::seconds kRest{1};
  static constexpr std::chrono::milliseconds kBetween{50};
  static constexpr std::size_t kMostAtOnce = 4;
  /// A node that does not answer is asked once more.
  static constexpr int kMostFailures = 2;

  /// `before_another` is the pause before that.
  explicit AskingPlan(std::chrono::nanoseconds before_another) : before_another_(before_another) {}

  /// Takes what the graph holds now.
  void see(const std::vector<AskableNode>& nodes, Time now);
  /// A node to ask now; `answered` or `failed` must follow.
  std::optional<std::string> next(Time now);
  void answered(const std::string& name, Time now);
  /// Whether it is given up.
  bool failed(const std::string& name, Time now);
  /// When `next` may have one; Time::max() when it will not before something else has happened.
  [[nodiscard]] Time due() const;

 private:
  enum class State { waiting, asked, done };

  struct Entry {
    std::set<AskableNode::Life> lives;
    State state = State::waiting;
    /// When it is to be asked, if it is waiting.
    Time due{};
    int failures = 0;
    /// It was found anew while it was asked.
    bool again = false;
    bool gone = false;
  };

  void begin(Entry& entry, Time now);
  void settle(const std::string& name, State state, Time now);

  const std::chrono::nanoseconds before_another_;
  std::map<std::string, Entry> entries_;
  std::size_t asked_ = 0;
  Time not_before_{};
};

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
