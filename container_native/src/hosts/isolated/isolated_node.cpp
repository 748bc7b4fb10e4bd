#include "hosts/isolated/isolated_node.hpp"

#include <signal.h>

#include <ctime>

#include "base/doorbell.hpp"
#include "base/report.hpp"

namespace play_launch::container {

void IsolatedNode::leave() noexcept {
  if (!leaving_.exchange(true)) {
    ring(doorbell_);
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
    case LifeCall::load_crashed:
      observer.on_load_crashed(unique_id_, death());
      on_death_reported();
      break;
    case LifeCall::gone:
      observer.on_gone(unique_id_, why_it_left());
      break;
    case LifeCall::crashed:
      observer.on_crashed(unique_id_, death());
      on_death_reported();
      break;
    case LifeCall::buried:
      observer.on_buried(unique_id_, is_cleaned_up());
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
