#pragma once

#include <rclcpp/node_options.hpp>

#include "components/component_options.hpp"

namespace play_launch::rclcpp_backend {

/// Options for the constructor of a component: what rclcpp_components' ComponentManager makes of a
/// request. Extra arguments that it does not know are not looked at, like there. Throws LoadError.
rclcpp::NodeOptions node_options(const container::ComponentOptions& component);

}  // namespace play_launch::rclcpp_backend
