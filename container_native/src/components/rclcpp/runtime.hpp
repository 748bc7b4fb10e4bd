#pragma once

#include <memory>
#include <play_launch/context.hpp>
#include <stdexcept>

namespace play_launch::rclcpp_backend {

/// Comes out of a component's call of rclcpp::Context::shutdown() in an isolated node, which is
/// leaving by then. rclcpp::shutdown() throws nothing.
class ContextIsShared : public std::runtime_error {
 public:
  ContextIsShared()
      : std::runtime_error("all nodes of a container share the ROS context: this node ends alone") {
  }
};

/// Initialises rclcpp for this process, with the default context that components expect to find,
/// and returns that context for the SDK: both kinds of nodes share one participant. Signals stay
/// the container's. The last owner that releases the result shuts rclcpp down.
///
/// `argv` is the command line; what follows `--ros-args` are the global arguments. Throws
/// std::exception. Once per process.
std::shared_ptr<Context> initialise(int argc, const char* const* argv);

}  // namespace play_launch::rclcpp_backend
