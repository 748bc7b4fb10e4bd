// Defines rcl_logging_rosout_add_sublogger() for the whole program, as exit_guard.cpp does with
// exit(). rclcpp calls it for the logger of a part of a node, while it has its lock for logging:
// this is the way to that lock.

#include "overrides/rclcpp_logging.hpp"

#include <rcl/logging_rosout.h>

#include <rclcpp/logger.hpp>
#include <utility>

#include "base/next_function.hpp"

namespace {

const auto next_rcl_logging_rosout_add_sublogger =
    play_launch::next_function<"rcl_logging_rosout_add_sublogger">(
        &rcl_logging_rosout_add_sublogger);

/// What the calling thread wants to have called in there.
constinit thread_local const std::function<void()>* wanted = nullptr;

}  // namespace

bool play_launch::rclcpp_backend::with_logging_lock(const std::function<void()>& function) {
  wanted = &function;
  static_cast<void>(rclcpp::get_logger("play_launch").get_child("burial"));
  return std::exchange(wanted, nullptr) == nullptr;
}

extern "C" rcl_ret_t rcl_logging_rosout_add_sublogger(const char* logger, const char* sublogger) {
  if (const auto* const function = std::exchange(wanted, nullptr)) {
    (*function)();
    return RCL_RET_NOT_FOUND;  // no node has a logger of that name
  }
  return next_rcl_logging_rosout_add_sublogger.get()(logger, sublogger);
}
