#include "hosts/isolated/isolated_node.hpp"

#include <signal.h>

#include "base/doorbell.hpp"
#include "base/report.hpp"

namespace play_launch::container {

void IsolatedNode::leave() noexcept {
  if (!leaving_.exchange(true)) {
    ring(doorbell_);
  }
}

IsolatedNode::Time IsolatedNode::press(Time now, Time end) {
  if (is_dead()) {
    if (now < end) {
      return end;
    }
    abandon();
    return Time::max();
  }
  // When all must end, so must a node that nobody can ask yet, because it constructs.
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
