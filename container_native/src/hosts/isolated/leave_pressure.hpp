#pragma once

#include <chrono>

namespace play_launch::container {

/// How a node's process is made to leave: it is asked, then gets SIGTERM, then SIGKILL. Pure: whose
/// process it is and how it is asked is the caller's business.
class LeavePressure {
 public:
  using Time = std::chrono::steady_clock::time_point;
  enum class Action { none, ask, terminate, kill };

  /// From being asked to SIGTERM, and from there to SIGKILL, unless all must end earlier.
  static constexpr std::chrono::seconds kPatience{1};
  static constexpr std::chrono::seconds kLastPatience{2};

  /// It is to leave, from `now` on. Only the first call counts.
  void begin(Time now);
  bool begun() const { return since_ != Time::max(); }

  /// What is to be done now, once each; `end` is when it must be gone (max: whenever).
  Action next(Time now, Time end);

  /// When to call next() again; max: never.
  Time due(Time end) const;

 private:
  struct Limits {
    Time terminate;
    Time kill;
  };
  Limits limits(Time end) const;

  Time since_ = Time::max();
  Action last_ = Action::none;
};

}  // namespace play_launch::container
