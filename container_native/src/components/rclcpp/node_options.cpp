#include "components/rclcpp/node_options.hpp"

#include <exception>
#include <rclcpp/logging.hpp>
#include <rclcpp/parameter.hpp>
#include <string>
#include <vector>

namespace play_launch::rclcpp_backend {
namespace {

std::vector<rclcpp::Parameter> parameters(const container::ComponentOptions& component) {
  std::vector<rclcpp::Parameter> result;
  result.reserve(component.parameters.size());
  for (const rcl_interfaces::msg::Parameter& message : component.parameters) {
    try {
      result.push_back(rclcpp::Parameter::from_parameter_msg(message));
    } catch (const std::exception& error) {
      throw container::LoadError("parameter '" + message.name + "': " + error.what());
    }
  }
  return result;
}

std::vector<std::string> arguments(const container::ComponentOptions& component) {
  std::vector<std::string> result{"--ros-args"};
  result.insert(result.end(), component.arguments.begin(), component.arguments.end());
  // After the remap rules: of several rules for a name the first one counts.
  if (!component.node_name.empty()) {
    result.insert(result.end(), {"-r", "__node:=" + component.node_name});
  }
  if (!component.node_namespace.empty()) {
    result.insert(result.end(), {"-r", "__ns:=" + component.node_namespace});
  }
  return result;
}

}  // namespace

rclcpp::NodeOptions node_options(const container::ComponentOptions& component) {
  if (component.forward_global_arguments) {
    RCLCPP_WARN(rclcpp::get_logger("component_container"),
                "forward_global_arguments: the arguments of the container, its name among them, "
                "now hold for the component as well");
  }
  return rclcpp::NodeOptions()
      .use_global_arguments(component.forward_global_arguments)
      .use_intra_process_comms(component.use_intra_process_comms)
      .parameter_overrides(parameters(component))
      .arguments(arguments(component));
}

}  // namespace play_launch::rclcpp_backend
