// Defines the functions of rcl that put something on the network, or take it off, for the whole
// program: like exit() in exit_guard.cpp, they come before those of the library. They do the same,
// and tell the HandleLedger of the calling thread, if there is one.

#include <rcl/client.h>
#include <rcl/logging_rosout.h>
#include <rcl/node.h>
#include <rcl/node_type_cache.h>
#include <rcl/publisher.h>
#include <rcl/service.h>
#include <rcl/subscription.h>

#include "base/next_function.hpp"
#include "components/rclcpp/handle_ledger.hpp"

namespace {

using play_launch::next_function;
using play_launch::rclcpp_backend::finalise_discarded_nodes;
using play_launch::rclcpp_backend::HandleKind;
using play_launch::rclcpp_backend::HandleLedger;

const auto next_rcl_node_init = next_function<"rcl_node_init">(&rcl_node_init);
const auto next_rcl_node_fini = next_function<"rcl_node_fini">(&rcl_node_fini);
const auto next_rcl_publisher_init = next_function<"rcl_publisher_init">(&rcl_publisher_init);
const auto next_rcl_publisher_fini = next_function<"rcl_publisher_fini">(&rcl_publisher_fini);
const auto next_rcl_subscription_init =
    next_function<"rcl_subscription_init">(&rcl_subscription_init);
const auto next_rcl_subscription_fini =
    next_function<"rcl_subscription_fini">(&rcl_subscription_fini);
const auto next_rcl_service_init = next_function<"rcl_service_init">(&rcl_service_init);
const auto next_rcl_node_type_description_service_init =
    next_function<"rcl_node_type_description_service_init">(
        &rcl_node_type_description_service_init);
const auto next_rcl_service_fini = next_function<"rcl_service_fini">(&rcl_service_fini);
const auto next_rcl_client_init = next_function<"rcl_client_init">(&rcl_client_init);
const auto next_rcl_client_fini = next_function<"rcl_client_fini">(&rcl_client_fini);
const auto next_rcl_logging_rosout_init_publisher_for_node =
    next_function<"rcl_logging_rosout_init_publisher_for_node">(
        &rcl_logging_rosout_init_publisher_for_node);

rcl_ret_t opened(rcl_ret_t result, HandleKind kind, void* handle, const rcl_node_t* node) {
  HandleLedger* const ledger = HandleLedger::current();
  if (result == RCL_RET_OK && ledger != nullptr) {
    ledger->opened(kind, handle, node);
  }
  return result;
}

void closing(const void* handle) {
  if (HandleLedger* const ledger = HandleLedger::current()) {
    ledger->closed(handle);
  }
}

}  // namespace

extern "C" {

rcl_ret_t rcl_node_init(rcl_node_t* node, const char* name, const char* name_space,
                        rcl_context_t* context, const rcl_node_options_t* options) {
  const auto init = next_rcl_node_init.get();
  return opened(init(node, name, name_space, context, options), HandleKind::node, node, node);
}

rcl_ret_t rcl_node_fini(rcl_node_t* node) {
  const auto fini = next_rcl_node_fini.get();
  closing(node);
  return fini(node);
}

rcl_ret_t rcl_publisher_init(rcl_publisher_t* publisher, const rcl_node_t* node,
                             const rosidl_message_type_support_t* type, const char* topic,
                             const rcl_publisher_options_t* options) {
  const auto init = next_rcl_publisher_init.get();
  return opened(init(publisher, node, type, topic, options), HandleKind::publisher, publisher,
                node);
}

rcl_ret_t rcl_publisher_fini(rcl_publisher_t* publisher, rcl_node_t* node) {
  const auto fini = next_rcl_publisher_fini.get();
  closing(publisher);
  return fini(publisher, node);
}

rcl_ret_t rcl_subscription_init(rcl_subscription_t* subscription, const rcl_node_t* node,
                                const rosidl_message_type_support_t* type, const char* topic,
                                const rcl_subscription_options_t* options) {
  const auto init = next_rcl_subscription_init.get();
  return opened(init(subscription, node, type, topic, options), HandleKind::subscription,
                subscription, node);
}

rcl_ret_t rcl_subscription_fini(rcl_subscription_t* subscription, rcl_node_t* node) {
  const auto fini = next_rcl_subscription_fini.get();
  closing(subscription);
  return fini(subscription, node);
}

rcl_ret_t rcl_service_init(rcl_service_t* service, const rcl_node_t* node,
                           const rosidl_service_type_support_t* type, const char* name,
                           const rcl_service_options_t* options) {
  const auto init = next_rcl_service_init.get();
  return opened(init(service, node, type, name, options), HandleKind::service, service, node);
}

rcl_ret_t rcl_node_type_description_service_init(rcl_service_t* service, const rcl_node_t* node) {
  const auto init = next_rcl_node_type_description_service_init.get();
  return opened(init(service, node), HandleKind::service, service, node);
}

rcl_ret_t rcl_service_fini(rcl_service_t* service, rcl_node_t* node) {
  const auto fini = next_rcl_service_fini.get();
  closing(service);
  return fini(service, node);
}

rcl_ret_t rcl_client_init(rcl_client_t* client, const rcl_node_t* node,
                          const rosidl_service_type_support_t* type, const char* name,
                          const rcl_client_options_t* options) {
  const auto init = next_rcl_client_init.get();
  return opened(init(client, node, type, name, options), HandleKind::client, client, node);
}

rcl_ret_t rcl_client_fini(rcl_client_t* client, rcl_node_t* node) {
  const auto fini = next_rcl_client_fini.get();
  closing(client);
  return fini(client, node);
}

// Called with rclcpp's lock for logging.

rcl_ret_t rcl_logging_rosout_init_publisher_for_node(rcl_node_t* node) {
  const auto init = next_rcl_logging_rosout_init_publisher_for_node.get();
  const HandleLedger::Pause pause;  // the publisher is the table's
  finalise_discarded_nodes();
  return init(node);
}

}  // extern "C"
