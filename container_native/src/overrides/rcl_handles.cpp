// Defines the functions of rcl that put something on the network, or take it off, for the whole
// program: like exit() in exit_guard.cpp, they come before those of the library, for the SDK, for
// rclcpp and for components. They do the same; in a child they enter it in the HandleLedger of its
// program, if that has one.
//
// And the one that takes in the description of a type, which waits until that is whole.

#include <rcl/client.h>
#include <rcl/logging_rosout.h>
#include <rcl/node.h>
#include <rcl/node_type_cache.h>
#include <rcl/publisher.h>
#include <rcl/service.h>
#include <rcl/subscription.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <span>
#include <thread>

#include "base/next_function.hpp"
#include "isolation/record/child_record.hpp"
#include "overrides/handle_ledger.hpp"

namespace {

using play_launch::HandleKind;
using play_launch::HandleLedger;
using play_launch::next_function;

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
const auto next_rcl_node_type_cache_register_type =
    next_function<"rcl_node_type_cache_register_type">(&rcl_node_type_cache_register_type);

/// Calls of rcl's functions that the calling thread is in. What one of them opens by another is its
/// own: rcl's table for /rosout takes a copy of the publisher, and finalises that.
constinit thread_local int depth = 0;

class Call {
 public:
  Call() noexcept { ++depth; }
  ~Call() { --depth; }
  Call(const Call&) = delete;
  Call& operator=(const Call&) = delete;
};

/// Null: nothing is entered.
HandleLedger* ledger() noexcept {
  const auto* const child = play_launch::isolation::current_child();
  return child != nullptr ? child->program->handles() : nullptr;
}

template <class Init>
rcl_ret_t opening(HandleKind kind, void* handle, const rcl_node_t* node, Init init) {
  rcl_ret_t result;
  {
    const Call call;
    result = init();
  }
  if (result == RCL_RET_OK && depth == 0) {
    if (HandleLedger* const entries = ledger()) {
      entries->opened(kind, handle, node);
    }
  }
  return result;
}

void closing(const void* handle) noexcept {
  if (HandleLedger* const entries = ledger()) {
    entries->closed(handle);
  }
}

using Description = rosidl_runtime_c__type_description__TypeDescription;
using Sources = rosidl_runtime_c__type_description__TypeSource__Sequence;

/// For a string or a sequence that another thread may be writing.
template <class Value>
bool is_there(const Value& value) {
  return __atomic_load_n(&value.data, __ATOMIC_ACQUIRE) != nullptr &&
         __atomic_load_n(&value.size, __ATOMIC_ACQUIRE) != 0;
}

bool is_filled(const Description& description, const Sources& sources) {
  const auto& types = description.referenced_type_descriptions;
  return std::ranges::all_of(std::span(types.data, types.size),
                             [](const auto& type) { return is_there(type.fields); }) &&
         std::ranges::all_of(std::span(sources.data, sources.size), [](const auto& source) {
           return is_there(source.type_name) && is_there(source.encoding) &&
                  (source.raw_file_contents.data != nullptr ||
                   std::strcmp(source.encoding.data, "implicit") == 0);
         });
}

/// The code that is generated for a type fills these tables when it is first asked for them, and
/// notes before it is done that it has: a second thread may be given empty ones, which rcl refuses.
/// The thread that fills them may have been killed, so this waits for a second at most.
void wait_until_filled(const Description& description, const Sources& sources) {
  constexpr std::chrono::microseconds kPause{100};
  for (int i = 0; i < 10'000 && !is_filled(description, sources); ++i) {
    std::this_thread::sleep_for(kPause);
  }
}

}  // namespace

extern "C" {

rcl_ret_t rcl_node_init(rcl_node_t* node, const char* name, const char* name_space,
                        rcl_context_t* context, const rcl_node_options_t* options) {
  return opening(HandleKind::node, node, node, [&] {
    return next_rcl_node_init.get()(node, name, name_space, context, options);
  });
}

rcl_ret_t rcl_node_fini(rcl_node_t* node) {
  closing(node);
  return next_rcl_node_fini.get()(node);
}

rcl_ret_t rcl_publisher_init(rcl_publisher_t* publisher, const rcl_node_t* node,
                             const rosidl_message_type_support_t* type, const char* topic,
                             const rcl_publisher_options_t* options) {
  return opening(HandleKind::publisher, publisher, node, [&] {
    return next_rcl_publisher_init.get()(publisher, node, type, topic, options);
  });
}

rcl_ret_t rcl_publisher_fini(rcl_publisher_t* publisher, rcl_node_t* node) {
  closing(publisher);
  return next_rcl_publisher_fini.get()(publisher, node);
}

rcl_ret_t rcl_subscription_init(rcl_subscription_t* subscription, const rcl_node_t* node,
                                const rosidl_message_type_support_t* type, const char* topic,
                                const rcl_subscription_options_t* options) {
  return opening(HandleKind::subscription, subscription, node, [&] {
    return next_rcl_subscription_init.get()(subscription, node, type, topic, options);
  });
}

rcl_ret_t rcl_subscription_fini(rcl_subscription_t* subscription, rcl_node_t* node) {
  closing(subscription);
  return next_rcl_subscription_fini.get()(subscription, node);
}

rcl_ret_t rcl_service_init(rcl_service_t* service, const rcl_node_t* node,
                           const rosidl_service_type_support_t* type, const char* name,
                           const rcl_service_options_t* options) {
  return opening(HandleKind::service, service, node,
                 [&] { return next_rcl_service_init.get()(service, node, type, name, options); });
}

rcl_ret_t rcl_node_type_description_service_init(rcl_service_t* service, const rcl_node_t* node) {
  return opening(HandleKind::service, service, node,
                 [&] { return next_rcl_node_type_description_service_init.get()(service, node); });
}

rcl_ret_t rcl_service_fini(rcl_service_t* service, rcl_node_t* node) {
  closing(service);
  return next_rcl_service_fini.get()(service, node);
}

rcl_ret_t rcl_client_init(rcl_client_t* client, const rcl_node_t* node,
                          const rosidl_service_type_support_t* type, const char* name,
                          const rcl_client_options_t* options) {
  return opening(HandleKind::client, client, node,
                 [&] { return next_rcl_client_init.get()(client, node, type, name, options); });
}

rcl_ret_t rcl_client_fini(rcl_client_t* client, rcl_node_t* node) {
  closing(client);
  return next_rcl_client_fini.get()(client, node);
}

rcl_ret_t rcl_logging_rosout_init_publisher_for_node(rcl_node_t* node) {
  // Before: a thread that dies in there may be in the table.
  if (HandleLedger* const entries = ledger()) {
    entries->logs(node);
  }
  const Call call;
  return next_rcl_logging_rosout_init_publisher_for_node.get()(node);
}

rcl_ret_t rcl_node_type_cache_register_type(const rcl_node_t* node, const rosidl_type_hash_t* hash,
                                            const Description* description,
                                            const Sources* sources) {
  if (description != nullptr && sources != nullptr) {
    wait_until_filled(*description, *sources);
  }
  return next_rcl_node_type_cache_register_type.get()(node, hash, description, sources);
}

}  // extern "C"
