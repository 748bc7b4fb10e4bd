#include "hosts/isolated/isolated_node.hpp"

#include <signal.h>

#include <algorithm>
#include <ctime>

#include "base/report.hpp"
#include "base/unique_fd.hpp"

namespace play_launch::container {

void LeavePressure::begin(Time now) { since_ = std::min(since_, now); }

LeavePressure::Limits LeavePressure::limits(Time end) const {
  Limits limits{since_ + kTerminateAfter, since_ + kTerminateAfter + kKillAfter};
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

void IsolatedNode::leave() noexcept {
  if (!leaving_.exchange(true)) {
    notify_eventfd(event_fd_);
  }
}

void IsolatedNode::follow(NodeHostObserver& observer) {
  seen_ = look();
  while (const std::optional<LifeCall> call = calls_.next(seen_)) {
    make(*call, observer);
  }
}

void IsolatedNode::make(LifeCall call, NodeHostObserver& observer) {
  switch (call) {
    case LifeCall::constructing: {
      clockid_t cpu_clock = CLOCK_THREAD_CPUTIME_ID;
      ::clock_getcpuclockid(process().pid, &cpu_clock);
      observer.on_constructing(unique_id_, process(), cpu_clock);
      break;
    }
    case LifeCall::loaded:
      if (!observer.on_loaded(unique_id_, full_name())) {
        leave();
      }
      break;
    case LifeCall::load_failed:
      observer.on_load_failed(unique_id_, failure());
      break;
    case LifeCall::gone:
      observer.on_gone(unique_id_, why_it_left());
      break;
    case LifeCall::died:
      observer.on_died(unique_id_, death());
      on_death_reported();
      break;
    case LifeCall::cleaned_up:
      observer.on_cleaned_up(unique_id_, is_cleaned_up());
      break;
  }
}

IsolatedNode::Time IsolatedNode::press(Time now, Time end) {
  if (has_any(seen_, NodeLife::ended | NodeLife::died)) {
    if (now < end) {
      return end;
    }
    abandon();
    return Time::max();
  }
  // When all must end, so must a node that cannot take requests yet, because it constructs.
  if (leaving_ || end != Time::max()) {
    pressure_.begin(now);
  }
  switch (pressure_.next(now, end)) {
    case LeavePressure::Action::none:
      break;
    case LeavePressure::Action::ask:
      ask_to_leave();
      break;
    case LeavePressure::Action::terminate:
      if (signal(SIGTERM)) {
        report(label() + " does not leave: sending it SIGTERM");
      }
      break;
    case LeavePressure::Action::kill:
      if (signal(SIGKILL)) {
        report(label() + " still does not leave: killing it");
      }
      break;
  }
  return pressure_.due(end);
}

std::string IsolatedNode::label() const {
  const std::string known = full_name();
  const std::string& name = known.empty() ? request().node_name : known;
  return (name.empty() ? "a node" : name) + " (" + request().plugin_name + ", unique_id " +
         std::to_string(unique_id_) + ")";
}

}  // namespace play_launch::container
