#include <rcl/error_handling.h>
#include <rmw/rmw.h>

#include <play_launch/context.hpp>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/error.hpp>
#include <play_launch/publisher.hpp>

#include "handles.hpp"

namespace play_launch {

PublisherBase::PublisherBase(const std::shared_ptr<NodeHandle>& node,
                             const rosidl_message_type_support_t* type_support,
                             std::type_index type, const std::string& topic, const QoS& qos,
                             bool intra_process)
    : handle_(std::make_shared<PublisherHandle>(node, type_support, topic, qos)),
      topic_(rcl_publisher_get_topic_name(handle_->rcl())) {
  if (!intra_process || !IntraProcessHub::suits(qos.profile())) return;
  rmw_gid_t gid;
  throw_unless_ok(rmw_get_gid_for_publisher(rcl_publisher_get_rmw_handle(handle_->rcl()), &gid),
                  "identify the publisher of topic '" + topic_ + "'");
  intra_process_ = detail::ContextAccess::intra_process(node->context())
                       .add_publisher(topic_, type, qos.profile(), gid, *node->rcl());
}

PublisherBase::~PublisherBase() = default;

std::size_t PublisherBase::subscription_count() const {
  if (!handle_->context().ok()) return 0;
  std::size_t count = 0;
  throw_unless_ok(rcl_publisher_get_subscription_count(handle_->rcl(), &count),
                  "count the subscriptions of topic '" + topic_ + "'");
  return count;
}

void PublisherBase::send(const void* message) const {
  const rcl_ret_t sent = rcl_publish(handle_->rcl(), message, nullptr);
  if (sent == RCL_RET_OK) return;
  if (!handle_->context().ok()) {
    rcl_reset_error();
    return;
  }
  throw RclError("publish on topic '" + topic_ + "'", sent);
}

}  // namespace play_launch
