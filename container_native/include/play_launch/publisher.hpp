#pragma once

#include <rosidl_runtime_c/message_type_support_struct.h>

#include <cstddef>
#include <memory>
#include <play_launch/detail/intra_process.hpp>
#include <play_launch/qos.hpp>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <stdexcept>
#include <string>
#include <typeindex>
#include <utility>

namespace play_launch {

class Context;
class NodeHandle;
class PublisherHandle;

/// The part of a publisher that does not depend on the message type.
class PublisherBase {
 public:
  virtual ~PublisherBase();
  PublisherBase(const PublisherBase&) = delete;
  PublisherBase& operator=(const PublisherBase&) = delete;

  /// Fully qualified topic name after remapping.
  [[nodiscard]] const std::string& topic() const noexcept { return topic_; }

  /// Matched subscriptions, those reached by pointer included. Throws RclError.
  [[nodiscard]] std::size_t subscription_count() const;

 protected:
  PublisherBase(const std::shared_ptr<NodeHandle>& node,
                const rosidl_message_type_support_t* type_support, std::type_index type,
                const std::string& topic, const QoS& qos, bool intra_process);

  /// Sends one message of the publisher's type. Throws RclError; silently does nothing when the
  /// context was shut down.
  void send(const void* message) const;

  /// Null unless the publisher takes part in delivery by pointer.
  [[nodiscard]] const IntraProcessPublication* intra_process() const noexcept {
    return intra_process_.get();
  }
  /// Whether subscriptions are matched that `reach` does not cover.
  [[nodiscard]] bool must_send_too(const IntraProcessReach& reach) const {
    return subscription_count() > reach.settled;
  }

 private:
  std::shared_ptr<PublisherHandle> handle_;
  std::string topic_;
  std::unique_ptr<IntraProcessPublication> intra_process_;
};

/// Publishes messages of type M. Any thread may publish.
template <class M>
class Publisher final : public PublisherBase {
 public:
  /// Use Node::create_publisher.
  Publisher(const std::shared_ptr<NodeHandle>& node, const std::string& topic, const QoS& qos,
            bool intra_process)
      : PublisherBase(node, rosidl_typesupport_cpp::get_message_type_support_handle<M>(), typeid(M),
                      topic, qos, intra_process) {}

  /// Publishes a copy. Throws RclError.
  void publish(const M& message) {
    if (intra_process() == nullptr) {
      send(&message);
      return;
    }
    const auto reach = intra_process()->reach();
    if (reach->inboxes.empty()) {
      send(&message);
      return;
    }
    deliver(std::make_unique<M>(message), *reach);
  }

  /// Publishes without copying where delivery is by pointer: all subscriptions that take
  /// `shared_ptr<const M>` or `const M&` see this very object; when there are none, one that takes
  /// `unique_ptr<M>` gets it, further ones get copies. Null throws std::invalid_argument.
  void publish(std::unique_ptr<M> message) {
    if (!message) throw std::invalid_argument("publish: message is null");
    if (intra_process() == nullptr) {
      send(message.get());
      return;
    }
    const auto reach = intra_process()->reach();
    deliver(std::move(message), *reach);
  }

 private:
  void deliver(std::unique_ptr<M> message, const IntraProcessReach& reach) {
    // First the middleware: afterwards the message may belong to a subscription.
    if (must_send_too(reach)) send(message.get());
    std::size_t owners = 0;
    for (const auto& inbox : reach.inboxes) owners += inbox->takes_ownership() ? 1 : 0;
    if (owners == reach.inboxes.size()) {
      deliver_to_owners(std::move(message), reach, owners);
      return;
    }
    const std::shared_ptr<const M> shared = std::move(message);
    for (const auto& inbox : reach.inboxes) {
      auto& typed = static_cast<TypedInbox<M>&>(*inbox);
      if (inbox->takes_ownership()) {
        typed.put(std::make_unique<M>(*shared));
      } else {
        typed.put(shared);
      }
    }
  }

  void deliver_to_owners(std::unique_ptr<M> message, const IntraProcessReach& reach,
                         std::size_t owners) {
    for (const auto& inbox : reach.inboxes) {
      auto& typed = static_cast<TypedInbox<M>&>(*inbox);
      typed.put(--owners == 0 ? std::move(message) : std::make_unique<M>(*message));
    }
  }
};

}  // namespace play_launch
