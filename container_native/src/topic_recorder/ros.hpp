#pragma once

#include <rcl/rcl.h>
#include <rmw/types.h>
#include <rosidl_runtime_c/message_type_support_struct.h>

#include <array>
#include <cstdint>
#include <set>
#include <string>
#include <vector>

namespace play_launch::topics {

/// A node of the graph that offers parameter services.
struct AskableNode {
  /// Identifies a publisher of /parameter_events, of which a node has a new one in each life.
  using Life = std::array<std::uint8_t, RMW_GID_STORAGE_SIZE>;

  /// Full name.
  std::string name;
  /// Empty when it does not publish there; several when others bear its name, or the one before it
  /// is not known to be dead yet.
  std::set<Life> lives;
};

/// Throws std::runtime_error, with rcl's reason, when a call failed.
void check(rcl_ret_t result, const std::string& action);

/// A topic of the graph.
struct GraphTopic {
  std::string name;
  std::vector<std::string> types;

  [[nodiscard]] std::string types_in_words() const;
};

/// Our only node, in a context of its own. Hidden, and it offers nothing: no parameters, no logs.
class RosNode {
 public:
  RosNode();
  RosNode(const RosNode&) = delete;
  RosNode& operator=(const RosNode&) = delete;
  ~RosNode();

  rcl_context_t* context() { return &context_; }
  const rcl_node_t* rcl() const { return &node_; }
  /// Notified when the graph changes.
  const rcl_guard_condition_t* graph() const { return rcl_node_get_graph_guard_condition(&node_); }

  [[nodiscard]] std::vector<GraphTopic> topics() const;
  /// What the publishers of a topic offer.
  [[nodiscard]] std::vector<rmw_qos_profile_t> offered(const std::string& topic) const;
  /// Those that offer the services for parameters, without hidden ones.
  [[nodiscard]] std::vector<AskableNode> askable_nodes() const;

 private:
  rcl_context_t context_ = rcl_get_zero_initialized_context();
  rcl_node_t node_ = rcl_get_zero_initialized_node();
};

/// Wakes a waiting thread from another one.
class GuardCondition {
 public:
  explicit GuardCondition(RosNode& node);
  GuardCondition(const GuardCondition&) = delete;
  GuardCondition& operator=(const GuardCondition&) = delete;
  ~GuardCondition();

  const rcl_guard_condition_t* rcl() const { return &guard_; }
  void trigger() noexcept;

 private:
  rcl_guard_condition_t guard_ = rcl_get_zero_initialized_guard_condition();
};

/// A subscription whose messages are taken as they came over the wire.
class SerializedSubscription {
 public:
  /// The node must outlive it.
  SerializedSubscription(RosNode& node, const rosidl_message_type_support_t* type_support,
                         const std::string& topic, const rmw_qos_profile_t& qos);
  SerializedSubscription(const SerializedSubscription&) = delete;
  SerializedSubscription& operator=(const SerializedSubscription&) = delete;
  ~SerializedSubscription();

  const rcl_subscription_t* rcl() const { return &subscription_; }
  [[nodiscard]] const rmw_qos_profile_t& qos() const { return qos_; }
  /// False when the last one was taken.
  bool take(rcl_serialized_message_t& message, rmw_message_info_t& info);

 private:
  RosNode& node_;
  const rmw_qos_profile_t qos_;
  rcl_subscription_t subscription_ = rcl_get_zero_initialized_subscription();
};

/// A client of a service.
class ServiceClient {
 public:
  /// The node must outlive it.
  ServiceClient(RosNode& node, const rosidl_service_type_support_t* type_support,
                const std::string& service);
  ServiceClient(const ServiceClient&) = delete;
  ServiceClient& operator=(const ServiceClient&) = delete;
  ~ServiceClient();

  const rcl_client_t* rcl() const { return &client_; }
  /// Whether the service is available.
  [[nodiscard]] bool is_available() const;
  /// Sends a request of the service's type; returns its number.
  template <class Request>
  std::int64_t send(const Request& request) {
    return send_any(&request);
  }
  /// Takes the answer to a request; false while it has not arrived.
  template <class Response>
  bool take(std::int64_t request, Response& response) {
    return take_any(request, &response);
  }

 private:
  std::int64_t send_any(const void* request);
  bool take_any(std::int64_t request, void* response);

  RosNode& node_;
  rcl_client_t client_ = rcl_get_zero_initialized_client();
};

/// What a thread waits for.
class WaitSet {
 public:
  explicit WaitSet(RosNode& node);
  WaitSet(const WaitSet&) = delete;
  WaitSet& operator=(const WaitSet&) = delete;
  ~WaitSet();

  /// Empties it, for so many.
  void begin(std::size_t subscriptions, std::size_t guards, std::size_t clients = 0);
  void add(const SerializedSubscription& subscription);
  void add(const rcl_guard_condition_t* guard);
  void add(const ServiceClient& client);
  /// Waits at most so many nanoseconds; forever if negative.
  void wait(std::int64_t timeout);
  /// By the order in which they were added.
  [[nodiscard]] bool is_subscription_ready(std::size_t index) const;
  [[nodiscard]] bool is_guard_ready(std::size_t index) const;

 private:
  rcl_wait_set_t set_ = rcl_get_zero_initialized_wait_set();
};

/// The type support in C of `package/msg/Name`, from the first prefix of AMENT_PREFIX_PATH that has
/// its library, else from wherever the loader finds it. The library stays loaded. Throws
/// std::runtime_error with the reason.
const rosidl_message_type_support_t* message_type_support(const std::string& type);

}  // namespace play_launch::topics
