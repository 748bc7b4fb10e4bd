#pragma once

#include <rmw/types.h>

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

namespace play_launch::topics {

/// A node of the graph that offers parameter services.
struct AskableNode {
  /// Identifies a publisher of /parameter_events, of which a node has a new one in each life.
  using Life = std::array<std::uint8_t, RMW_GID_STORAGE_SIZE>;

  /// Full name.
  std::string name;
  /// Empty when it does not publish there; several when others bear its name, or the one before it
  /// is not known to be dead yet.
  std::set<Life> lives;
};

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

}  // namespace play_launch::topics
