// Defines functions for the whole program, as exit_guard.cpp does with exit().

#include "overrides/rclcpp_functions.hpp"

#include <rcl/logging_rosout.h>

#include <atomic>
#include <play_launch/detail/context_access.hpp>
#include <rclcpp/contexts/default_context.hpp>
#include <rclcpp/logger.hpp>
#include <rclcpp/utilities.hpp>
#include <string>
#include <utility>

#include "base/next_function.hpp"

namespace {

std::atomic<play_launch::Context*> guarded{nullptr};

}  // namespace

void play_launch::rclcpp_backend::guard_default_context(Context* context) noexcept {
  guarded = context;
}

/// Instead of librclcpp's, for the whole program: the executable exports its symbols, so libraries
/// of components find this one first. There are no signal handlers of rclcpp to be taken back.
bool rclcpp::shutdown(rclcpp::Context::SharedPtr context, const std::string& reason) {
  const rclcpp::Context::SharedPtr global_context = rclcpp::contexts::get_global_default_context();
  if (context == nullptr) {
    context = global_context;
  }
  play_launch::Context* const shared = guarded;
  if (context == global_context && shared != nullptr &&
      !play_launch::detail::ContextAccess::may_shut_down(*shared, __builtin_return_address(0))) {
    return true;
  }
  return context->shutdown(reason);
}

namespace {

const auto next_rcl_logging_rosout_add_sublogger =
    play_launch::next_function<"rcl_logging_rosout_add_sublogger">(
        &rcl_logging_rosout_add_sublogger);

/// What the calling thread wants to have called in there.
constinit thread_local const std::function<void()>* wanted = nullptr;

}  // namespace

bool play_launch::rclcpp_backend::with_logging_lock(const std::function<void()>& function) {
  wanted = &function;
  static_cast<void>(rclcpp::get_logger("play_launch").get_child("cleanup"));
  return std::exchange(wanted, nullptr) == nullptr;
}

/// rclcpp calls it for the logger of a part of a node, while it has its lock for logging: this is
/// the way to that lock.
extern "C" rcl_ret_t rcl_logging_rosout_add_sublogger(const char* logger, const char* sublogger) {
  if (const auto* const function = std::exchange(wanted, nullptr)) {
    (*function)();
    return RCL_RET_NOT_FOUND;  // no node has a logger of that name
  }
  return next_rcl_logging_rosout_add_sublogger.get()(logger, sublogger);
}
