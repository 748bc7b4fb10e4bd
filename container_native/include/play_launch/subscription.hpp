#pragma once

#include <rmw/types.h>
#include <rosidl_runtime_c/message_type_support_struct.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <play_launch/detail/intra_process.hpp>
#include <play_launch/detail/waitable.hpp>
#include <play_launch/qos.hpp>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <string>
#include <type_traits>
#include <typeindex>
#include <utility>

namespace play_launch {

class NodeHandle;
class SubscriptionHandle;

/// The part of a subscription that does not depend on the message type. Lives as long as an owner
/// holds it; its callback runs in the executor that holds the node.
class SubscriptionBase : public Waitable {
 public:
  ~SubscriptionBase() override;

  /// Fully qualified topic name after remapping.
  [[nodiscard]] const std::string& topic() const noexcept { return topic_; }
  /// Matched publishers. Throws RclError.
  [[nodiscard]] std::size_t publisher_count() const;
  /// Messages delivered by pointer that gave way to newer ones before the callback came to them.
  [[nodiscard]] std::uint64_t dropped() const noexcept;

 protected:
  SubscriptionBase(std::shared_ptr<CallbackGroup> group, Logger logger);

  /// Second part of construction. `inbox` is null unless the subscription takes part in delivery
  /// by pointer.
  void open(const std::shared_ptr<NodeHandle>& node,
            const rosidl_message_type_support_t* type_support, std::type_index type,
            const std::string& topic, const QoS& qos, std::shared_ptr<IntraProcessInbox> inbox);

  /// Takes one message from the middleware into `message`, skipping those that also come by
  /// pointer. False if none is pending. Throws RclError.
  bool take_from_middleware(void* message);

 private:
  std::string topic_;
  std::shared_ptr<SubscriptionHandle> handle_;
  std::shared_ptr<IntraProcessInbox> inbox_;
  std::unique_ptr<IntraProcessSubscription> intra_process_;
};

namespace detail {

template <class F, class M>
inline constexpr bool takes_reference = std::is_invocable_v<F&, const M&>;
template <class F, class M>
inline constexpr bool takes_shared =
    !takes_reference<F, M> && std::is_invocable_v<F&, std::shared_ptr<const M>>;
template <class F, class M>
inline constexpr bool takes_unique =
    !takes_reference<F, M> && !takes_shared<F, M> && std::is_invocable_v<F&, std::unique_ptr<M>>;

}  // namespace detail

/// Calls `F` for each message of type M: void(const M&), void(std::shared_ptr<const M>) or
/// void(std::unique_ptr<M>).
template <class M, class F>
class CallbackSubscription;

/// What users hold; see CallbackSubscription.
template <class M>
class Subscription : public SubscriptionBase {
 protected:
  using SubscriptionBase::SubscriptionBase;
};

template <class M, class F>
class CallbackSubscription final : public Subscription<M> {
  static constexpr bool takes_unique = detail::takes_unique<F, M>;
  static_assert(detail::takes_reference<F, M> || detail::takes_shared<F, M> || takes_unique,
                "the callback must take const M&, std::shared_ptr<const M> or std::unique_ptr<M>");

 public:
  /// Use Node::create_subscription.
  CallbackSubscription(const std::shared_ptr<NodeHandle>& node, const std::string& topic,
                       const QoS& qos, F callback, bool intra_process,
                       std::shared_ptr<CallbackGroup> group, Logger logger)
      : Subscription<M>(std::move(group), std::move(logger)),
        callback_(std::make_shared<F>(std::move(callback))) {
    if (intra_process && IntraProcessHub::suits(qos.profile())) {
      inbox_ = std::make_shared<TypedInbox<M>>(qos.depth(), takes_unique, this->token());
    }
    this->open(node, rosidl_typesupport_cpp::get_message_type_support_handle<M>(), typeid(M), topic,
               qos, inbox_);
  }

  Work take() override {
    const std::lock_guard lock(take_mutex_);
    // Alternate between the two sources, so that neither starves the other.
    inbox_first_ = !inbox_first_;
    for (const bool from_inbox : {inbox_first_, !inbox_first_}) {
      if (from_inbox) {
        typename TypedInbox<M>::Item item;
        if (!inbox_ || !inbox_->take(item)) continue;
        if constexpr (takes_unique) {
          return work(std::move(item.owned));
        } else {
          return work(std::move(item.shared));
        }
      }
      auto message = std::make_unique<M>();
      if (!this->take_from_middleware(message.get())) continue;
      if constexpr (takes_unique) {
        return work(std::move(message));
      } else {
        return work(std::shared_ptr<const M>(std::move(message)));
      }
    }
    return Work();
  }

 private:
  template <class P>
  Work work(P message) {
    // The callback is shared: it may outlive the subscription when it releases that itself.
    return Work([callback = callback_, message = std::move(message)]() mutable {
      if constexpr (detail::takes_reference<F, M>) {
        (*callback)(*message);
      } else {
        (*callback)(std::move(message));
      }
    });
  }

  const std::shared_ptr<F> callback_;
  std::shared_ptr<TypedInbox<M>> inbox_;
  std::mutex take_mutex_;
  bool inbox_first_ = false;
};

}  // namespace play_launch
