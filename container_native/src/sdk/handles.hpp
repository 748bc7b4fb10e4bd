#pragma once

#include <rcl/node.h>
#include <rcl/publisher.h>
#include <rcl/service.h>
#include <rcl/subscription.h>

#include <memory>
#include <mutex>
#include <string>

namespace play_launch {

class Context;
class QoS;
class WakeToken;

/// Owns a rcl_node_t. Everything made with it keeps it alive.
class NodeHandle final {
 public:
  /// `options` are copied. Throws RclError.
  NodeHandle(std::shared_ptr<Context> context, const std::string& name,
             const std::string& name_space, const rcl_node_options_t& options);
  ~NodeHandle();
  NodeHandle(const NodeHandle&) = delete;
  NodeHandle& operator=(const NodeHandle&) = delete;

  [[nodiscard]] rcl_node_t* rcl() noexcept { return &node_; }
  [[nodiscard]] Context& context() noexcept { return *context_; }

  /// A topic or service name, expanded and remapped. Throws RclError.
  [[nodiscard]] std::string resolve(const std::string& name, bool is_service) const;

  /// To be held while entities of the node are made or finalised: rcl keeps an unguarded table of
  /// types per node.
  [[nodiscard]] std::mutex& mutex() noexcept { return mutex_; }

 private:
  const std::shared_ptr<Context> context_;
  std::mutex mutex_;
  rcl_node_t node_ = rcl_get_zero_initialized_node();
};

/// Owns a rcl_publisher_t.
class PublisherHandle final {
 public:
  PublisherHandle(std::shared_ptr<NodeHandle> node,
                  const rosidl_message_type_support_t* type_support, const std::string& topic,
                  const QoS& qos);
  ~PublisherHandle();
  PublisherHandle(const PublisherHandle&) = delete;
  PublisherHandle& operator=(const PublisherHandle&) = delete;

  [[nodiscard]] rcl_publisher_t* rcl() noexcept { return &publisher_; }
  [[nodiscard]] Context& context() noexcept { return node_->context(); }

 private:
  const std::shared_ptr<NodeHandle> node_;
  rcl_publisher_t publisher_ = rcl_get_zero_initialized_publisher();
};

/// Owns a rcl_subscription_t that notifies a token of new messages.
class SubscriptionHandle final {
 public:
  SubscriptionHandle(std::shared_ptr<NodeHandle> node,
                     const rosidl_message_type_support_t* type_support, const std::string& topic,
                     const QoS& qos, std::shared_ptr<WakeToken> token);
  ~SubscriptionHandle();
  SubscriptionHandle(const SubscriptionHandle&) = delete;
  SubscriptionHandle& operator=(const SubscriptionHandle&) = delete;

  [[nodiscard]] rcl_subscription_t* rcl() noexcept { return &subscription_; }

 private:
  const std::shared_ptr<NodeHandle> node_;
  // Outlives the subscription, so that the middleware may notify until the very end.
  const std::shared_ptr<WakeToken> token_;
  rcl_subscription_t subscription_ = rcl_get_zero_initialized_subscription();
};

/// Owns a rcl_service_t that notifies a token of new requests.
class ServiceHandle final {
 public:
  ServiceHandle(std::shared_ptr<NodeHandle> node, const rosidl_service_type_support_t* type_support,
                const std::string& name, const QoS& qos, std::shared_ptr<WakeToken> token);
  ~ServiceHandle();
  ServiceHandle(const ServiceHandle&) = delete;
  ServiceHandle& operator=(const ServiceHandle&) = delete;

  [[nodiscard]] rcl_service_t* rcl() noexcept { return &service_; }
  [[nodiscard]] Context& context() noexcept { return node_->context(); }

 private:
  const std::shared_ptr<NodeHandle> node_;
  const std::shared_ptr<WakeToken> token_;
  rcl_service_t service_ = rcl_get_zero_initialized_service();
};

}  // namespace play_launch
