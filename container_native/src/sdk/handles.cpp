#include "handles.hpp"

#include <rcl/error_handling.h>

#include <cstdlib>
#include <play_launch/context.hpp>
#include <play_launch/error.hpp>
#include <play_launch/logging.hpp>
#include <play_launch/qos.hpp>
#include <utility>

#include "ready_queue.hpp"

namespace play_launch {
namespace {

/// Called by a thread of the middleware.
void notify_token(const void* token, std::size_t events) {
  const_cast<WakeToken*>(static_cast<const WakeToken*>(token))->notify(events);
}

/// A destructor can do no more than report it.
void report_unless_ok(rcl_ret_t code, const char* doing) noexcept {
  if (code == RCL_RET_OK) return;
  try {
    PLAY_LAUNCH_ERROR(Logger("play_launch"), "%s", RclError(doing, code).what());
  } catch (...) {  // out of memory: nothing left to report it with
  }
}

}  // namespace

NodeHandle::NodeHandle(std::shared_ptr<Context> context, const std::string& name,
                       const std::string& name_space, const rcl_node_options_t& options)
    : context_(std::move(context)) {
  throw_unless_ok(
      rcl_node_init(&node_, name.c_str(), name_space.c_str(), context_->rcl(), &options),
      "create node '" + name + "'");
}

NodeHandle::~NodeHandle() { report_unless_ok(rcl_node_fini(&node_), "finalise a node"); }

std::string NodeHandle::resolve(const std::string& name, bool is_service) const {
  constexpr bool kAlsoRemap = false;  // the parameter is called only_expand
  char* resolved = nullptr;
  const rcl_allocator_t allocator = rcl_get_default_allocator();
  throw_unless_ok(
      rcl_node_resolve_name(&node_, name.c_str(), allocator, is_service, kAlsoRemap, &resolved),
      "resolve name '" + name + "'");
  const std::unique_ptr<char, decltype(&std::free)> owner(resolved, &std::free);
  return resolved;
}

PublisherHandle::PublisherHandle(std::shared_ptr<NodeHandle> node,
                                 const rosidl_message_type_support_t* type_support,
                                 const std::string& topic, const QoS& qos)
    : node_(std::move(node)) {
  rcl_publisher_options_t options = rcl_publisher_get_default_options();
  options.qos = qos.profile();
  const std::lock_guard lock(node_->mutex());
  throw_unless_ok(
      rcl_publisher_init(&publisher_, node_->rcl(), type_support, topic.c_str(), &options),
      "create a publisher for topic '" + topic + "'");
}

PublisherHandle::~PublisherHandle() {
  const std::lock_guard lock(node_->mutex());
  report_unless_ok(rcl_publisher_fini(&publisher_, node_->rcl()), "finalise a publisher");
}

SubscriptionHandle::SubscriptionHandle(std::shared_ptr<NodeHandle> node,
                                       const rosidl_message_type_support_t* type_support,
                                       const std::string& topic, const QoS& qos,
                                       std::shared_ptr<WakeToken> token)
    : node_(std::move(node)), token_(std::move(token)) {
  rcl_subscription_options_t options = rcl_subscription_get_default_options();
  options.qos = qos.profile();
  const std::lock_guard lock(node_->mutex());
  const rcl_ret_t made =
      rcl_subscription_init(&subscription_, node_->rcl(), type_support, topic.c_str(), &options);
  if (rcl_subscription_options_fini(&options) != RCL_RET_OK) rcl_reset_error();
  throw_unless_ok(made, "create a subscription for topic '" + topic + "'");
  // Set once and never taken back: rmw_fastrtps may call a callback that was just taken back.
  const rcl_ret_t set = rcl_subscription_set_on_new_message_callback(
      &subscription_, notify_token, static_cast<const void*>(token_.get()));
  if (set == RCL_RET_OK) return;
  const RclError error("watch the subscription of topic '" + topic + "'", set);
  report_unless_ok(rcl_subscription_fini(&subscription_, node_->rcl()), "finalise a subscription");
  throw error;
}

SubscriptionHandle::~SubscriptionHandle() {
  const std::lock_guard lock(node_->mutex());
  report_unless_ok(rcl_subscription_fini(&subscription_, node_->rcl()), "finalise a subscription");
}

ServiceHandle::ServiceHandle(std::shared_ptr<NodeHandle> node,
                             const rosidl_service_type_support_t* type_support,
                             const std::string& name, const QoS& qos,
                             std::shared_ptr<WakeToken> token)
    : node_(std::move(node)), token_(std::move(token)) {
  rcl_service_options_t options = rcl_service_get_default_options();
  options.qos = qos.profile();
  const std::lock_guard lock(node_->mutex());
  throw_unless_ok(rcl_service_init(&service_, node_->rcl(), type_support, name.c_str(), &options),
                  "create service '" + name + "'");
  const rcl_ret_t set = rcl_service_set_on_new_request_callback(
      &service_, notify_token, static_cast<const void*>(token_.get()));
  if (set == RCL_RET_OK) return;
  const RclError error("watch service '" + name + "'", set);
  report_unless_ok(rcl_service_fini(&service_, node_->rcl()), "finalise a service");
  throw error;
}

ServiceHandle::~ServiceHandle() {
  const std::lock_guard lock(node_->mutex());
  report_unless_ok(rcl_service_fini(&service_, node_->rcl()), "finalise a service");
}

}  // namespace play_launch
