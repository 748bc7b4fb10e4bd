#pragma once

#include <optional>
#include <play_launch_msgs/msg/control_load.hpp>
#include <stdexcept>
#include <string>
#include <vector>

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

/// What a load request means for a node, the same for every kind of component.
struct ComponentOptions {
  std::string node_name;       // empty: the component's own
  std::string node_namespace;  // empty: the component's own; else it begins with "/"
  /// Remap rules as ROS arguments: "-r", "from:=to", ...
  std::vector<std::string> arguments;
  bool use_intra_process_comms = false;
  /// Off by default: the container's own arguments, its name above all, are not meant for the nodes
  /// in it.
  bool forward_global_arguments = false;
  int log_level = 0;
  std::vector<rcl_interfaces::msg::Parameter> parameters;
  /// Those that the container does not handle itself.
  std::vector<rcl_interfaces::msg::Parameter> extra_arguments;
};

/// Throws LoadError when something in the request is wrong: names, remap rules, types of
/// extra arguments, an unknown parameter type.
ComponentOptions component_options(const LoadRequest& request);

/// Full name that a node will have whose default namespace is the root, as far as it can be known
/// before construction. Nothing: it is not certain, or not valid.
std::optional<std::string> expected_full_name(const LoadRequest& request);

}  // namespace play_launch::container
