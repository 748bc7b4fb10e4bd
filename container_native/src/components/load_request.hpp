#pragma once

#include <play_launch_msgs/msg/control_load.hpp>
#include <stdexcept>
#include <string>

namespace play_launch::container {

/// A wish to load one component, whichever way it came; `attempt` is 0 when it did not come from
/// the control channel. An empty name or namespace is the component's own.
using LoadRequest = play_launch_msgs::msg::ControlLoad;

/// Why a component could not be loaded, worded for the user.
class LoadError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Text for the exception that is being handled, whatever its type; for use in a catch (...).
std::string describe_current_exception();

}  // namespace play_launch::container
