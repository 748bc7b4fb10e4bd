#pragma once

#include <play_launch/context.hpp>

namespace play_launch::rclcpp_backend {

/// rclcpp_context.cpp defines rclcpp::shutdown() for the whole program: it asks `context`, which is
/// rclcpp's default one as the SDK sees it, whether the default one may be shut down. Null: no
/// library is asked any more.
void guard_default_context(Context* context) noexcept;

}  // namespace play_launch::rclcpp_backend
