#include "hosts/isolated/leave_pressure.hpp"

#include <algorithm>

namespace play_launch::container {

void LeavePressure::begin(Time now) { since_ = std::min(since_, now); }

LeavePressure::Limits LeavePressure::limits(Time end) const {
  Limits limits{since_ + kPatience, since_ + kPatience + kLastPatience};
  if (end != Time::max()) {
    const auto whole = std::max(end - since_, Time::duration::zero());
    limits.terminate = std::min(limits.terminate, since_ + whole / 2);
    // Some time must be left to notice the death, and to clean up after it.
    limits.kill = std::min(limits.kill, since_ + whole * 4 / 5);
  }
  return limits;
}

LeavePressure::Action LeavePressure::next(Time now, Time end) {
  if (!begun()) {
    return Action::none;
  }
  if (last_ == Action::none) {
    return last_ = Action::ask;
  }
  const Limits limit = limits(end);
  if (last_ == Action::ask && now >= limit.terminate) {
    return last_ = Action::terminate;
  }
  if (last_ == Action::terminate && now >= limit.kill) {
    return last_ = Action::kill;
  }
  return Action::none;
}

LeavePressure::Time LeavePressure::due(Time end) const {
  if (!begun() || last_ == Action::kill) {
    return Time::max();
  }
  if (last_ == Action::none) {
    return since_;
  }
  const Limits limit = limits(end);
  return last_ == Action::ask ? limit.terminate : limit.kill;
}

}  // namespace play_launch::container
