#include "overrides/rclcpp_context.hpp"

#include <atomic>
#include <play_launch/detail/context_access.hpp>
#include <rclcpp/contexts/default_context.hpp>
#include <rclcpp/utilities.hpp>
#include <string>

namespace {

std::atomic<play_launch::Context*> guarded{nullptr};

}  // namespace

void play_launch::rclcpp_backend::guard_default_context(Context* context) noexcept {
  guarded = context;
}

/// Instead of librclcpp's, for the whole program: the executable exports its symbols, so libraries
/// of components find this one first. There are no signal handlers of rclcpp to be taken back.
bool rclcpp::shutdown(rclcpp::Context::SharedPtr context, const std::string& reason) {
  const rclcpp::Context::SharedPtr everybodys = rclcpp::contexts::get_global_default_context();
  if (context == nullptr) {
    context = everybodys;
  }
  play_launch::Context* const shared = guarded;
  if (context == everybodys && shared != nullptr &&
      !play_launch::detail::ContextAccess::may_shut_down(*shared, __builtin_return_address(0))) {
    return true;
  }
  return context->shutdown(reason);
}
