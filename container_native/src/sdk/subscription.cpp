#include <rcl/error_handling.h>

#include <play_launch/context.hpp>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/error.hpp>
#include <play_launch/subscription.hpp>

#include "handles.hpp"

namespace play_launch {

SubscriptionBase::SubscriptionBase(std::shared_ptr<CallbackGroup> group, Logger logger)
    : Waitable(Readiness::notified, std::move(group), std::move(logger)) {}

SubscriptionBase::~SubscriptionBase() = default;

void SubscriptionBase::open(const std::shared_ptr<NodeHandle>& node,
                            const rosidl_message_type_support_t* type_support, std::type_index type,
                            const std::string& topic, const QoS& qos,
                            std::shared_ptr<IntraProcessInbox> inbox) {
  inbox_ = std::move(inbox);
  if (inbox_) {
    intra_process_ = detail::ContextAccess::intra_process(node->context())
                         .add_subscription(node->resolve(topic, false), type, qos.profile(), inbox_,
                                           *node->rcl());
  }
  handle_ = std::make_shared<SubscriptionHandle>(node, type_support, topic, qos, token());
  topic_ = rcl_subscription_get_topic_name(handle_->rcl());
  if (intra_process_) intra_process_->settle();
}

std::size_t SubscriptionBase::publisher_count() const {
  std::size_t count = 0;
  throw_unless_ok(rcl_subscription_get_publisher_count(handle_->rcl(), &count),
                  "count the publishers of topic '" + topic_ + "'");
  return count;
}

std::uint64_t SubscriptionBase::dropped() const noexcept { return inbox_ ? inbox_->dropped() : 0; }

bool SubscriptionBase::take_from_middleware(void* message) {
  while (true) {
    rmw_message_info_t info = rmw_get_zero_initialized_message_info();
    const rcl_ret_t taken = rcl_take(handle_->rcl(), message, &info, nullptr);
    if (taken == RCL_RET_SUBSCRIPTION_TAKE_FAILED) {
      rcl_reset_error();
      return false;
    }
    throw_unless_ok(taken, "take a message of topic '" + topic_ + "'");
    if (!intra_process_ || !intra_process_->delivered_by_pointer(info.publisher_gid)) return true;
  }
}

}  // namespace play_launch
