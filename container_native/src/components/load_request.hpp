#pragma once

#include <cstdint>
#include <rcl_interfaces/msg/parameter.hpp>
#include <stdexcept>
#include <string>
#include <vector>

namespace play_launch::container {

/// A wish to load one component, whichever way it came.
struct LoadRequest {
  std::uint64_t attempt = 0;  // 0: not from the control channel
  std::string package_name;
  std::string plugin_name;
  std::string node_name;       // empty: the component's own
  std::string node_namespace;  // empty: the component's own
  std::uint8_t log_level = 0;
  std::vector<std::string> remap_rules;
  std::vector<rcl_interfaces::msg::Parameter> parameters;
  std::vector<rcl_interfaces::msg::Parameter> extra_arguments;
};

/// From composition_interfaces/LoadNode's request or play_launch_msgs/ControlLoad, which have these
/// fields in common.
template <class Message>
LoadRequest load_request_from(const Message& message) {
  LoadRequest request;
  request.package_name = message.package_name;
  request.plugin_name = message.plugin_name;
  request.node_name = message.node_name;
  request.node_namespace = message.node_namespace;
  request.log_level = message.log_level;
  request.remap_rules = message.remap_rules;
  request.parameters = message.parameters;
  request.extra_arguments = message.extra_arguments;
  return request;
}

/// Why a component could not be loaded, worded for the person who asked for it.
class LoadError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Text for the exception that is being handled, whatever its type; for use in a catch (...).
std::string describe_current_exception();

}  // namespace play_launch::container
