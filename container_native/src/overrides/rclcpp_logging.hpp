#pragma once

#include <functional>

namespace play_launch::rclcpp_backend {

/// Calls a function with rclcpp's lock for logging, which guards rcl's table of the nodes that log
/// to /rosout, and which rclcpp hides. False: the function was not called. Throws what rclcpp
/// throws.
bool with_logging_lock(const std::function<void()>& function);

}  // namespace play_launch::rclcpp_backend
