#pragma once

#include <functional>
#include <play_launch/context.hpp>

namespace play_launch::rclcpp_backend {

/// rclcpp_functions.cpp defines rclcpp::shutdown() for the whole program: it asks `context`, which
/// is rclcpp's default one as the SDK sees it, whether the default one may be shut down. Null: no
/// library is asked any more.
void guard_default_context(Context* context) noexcept;

/// Calls a function with rclcpp's lock for logging, which guards rcl's table of the nodes that log
/// to /rosout, and which rclcpp hides. False: the function was not called. Throws what rclcpp
/// throws.
bool with_logging_lock(const std::function<void()>& function);

}  // namespace play_launch::rclcpp_backend
