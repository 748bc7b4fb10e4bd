#pragma once

#include <memory>
#include <play_launch/parameter.hpp>
#include <string>
#include <vector>

namespace play_launch {

class Context;

/// How to make a node. A component gets this object from its loader and passes it to Node.
struct NodeOptions {
  /// The context the node belongs to; must not be null.
  std::shared_ptr<Context> context;

  /// ROS arguments for this node only, without the leading `--ros-args`:
  /// {"-r", "chatter:=talk", "-p", "rate:=5.0", "--log-level", "debug"}.
  std::vector<std::string> arguments;

  /// Whether the context's arguments apply to this node after its own.
  bool use_global_arguments = true;

  /// Hand messages on by pointer to subscriptions of the same context.
  bool use_intra_process_comms = false;

  /// Publish the node's log to /rosout.
  bool enable_rosout = true;

  /// Offer the six parameter services and publish /parameter_events.
  bool start_parameter_services = true;

  /// Least severity that is logged (10 debug, 20 info, 30 warn, 40 error, 50 fatal); 0 = as the
  /// arguments say.
  int log_level = 0;

  /// Values that win over those of arguments and parameter files.
  std::vector<Parameter> parameter_overrides;

  /// Arguments for the component itself, which the SDK does not look at.
  std::vector<Parameter> extra_arguments;

  /// Name and namespace that win over the component's own and over all arguments, when not empty.
  std::string name;
  std::string name_space;
};

}  // namespace play_launch
