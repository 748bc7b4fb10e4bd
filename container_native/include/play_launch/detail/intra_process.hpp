#pragma once

#include <rcl/node.h>
#include <rmw/types.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <typeindex>
#include <utility>
#include <vector>

namespace play_launch {

class WakeToken;
class IntraProcessTopic;

/// Where publishers leave messages for one subscription: bounded by the subscription's depth, the
/// oldest message gives way and is counted.
class IntraProcessInbox {
 public:
  IntraProcessInbox(std::size_t depth, bool takes_ownership, std::shared_ptr<WakeToken> token);
  virtual ~IntraProcessInbox();
  IntraProcessInbox(const IntraProcessInbox&) = delete;
  IntraProcessInbox& operator=(const IntraProcessInbox&) = delete;

  /// True when the subscription wants messages as unique_ptr.
  [[nodiscard]] bool takes_ownership() const noexcept { return takes_ownership_; }
  /// Messages that gave way to newer ones before they were taken.
  [[nodiscard]] std::uint64_t dropped() const noexcept { return dropped_.load(); }
  /// Destroys what is in it.
  virtual void clear() = 0;

 protected:
  [[nodiscard]] std::size_t depth() const noexcept { return depth_; }
  void count_drop() noexcept { ++dropped_; }
  void wake() noexcept;

 private:
  const std::size_t depth_;
  const bool takes_ownership_;
  const std::shared_ptr<WakeToken> token_;
  std::atomic<std::uint64_t> dropped_{0};
};

/// The inbox for messages of type M.
template <class M>
class TypedInbox final : public IntraProcessInbox {
 public:
  using IntraProcessInbox::IntraProcessInbox;

  /// One of the two is set: `owned` when takes_ownership(), else `shared`.
  struct Item {
    std::shared_ptr<const M> shared;
    std::unique_ptr<M> owned;
  };

  void put(std::shared_ptr<const M> message) { put(Item{std::move(message), nullptr}); }
  void put(std::unique_ptr<M> message) { put(Item{nullptr, std::move(message)}); }

  /// The oldest message; false if the buffer is empty.
  bool take(Item& item) {
    const std::lock_guard lock(mutex_);
    if (items_.empty()) return false;
    item = std::move(items_.front());
    items_.pop_front();
    return true;
  }

  void clear() override {
    std::deque<Item> items;
    const std::lock_guard lock(mutex_);
    items.swap(items_);
  }

 private:
  void put(Item item) {
    Item displaced;  // freed after the lock: a message's destructor may take long
    {
      const std::lock_guard lock(mutex_);
      if (items_.size() >= depth()) {
        displaced = std::move(items_.front());
        items_.pop_front();
        count_drop();
      }
      items_.push_back(std::move(item));
    }
    wake();
  }

  std::mutex mutex_;
  std::deque<Item> items_;
};

/// What one publisher reaches without the middleware.
struct IntraProcessReach {
  std::vector<std::shared_ptr<IntraProcessInbox>> inboxes;
  /// How many of their subscriptions the middleware counts as matched, too.
  std::size_t settled = 0;
};

/// Registration of a publisher; ends with the object.
class IntraProcessPublication final {
 public:
  IntraProcessPublication(std::shared_ptr<IntraProcessTopic> topic, rmw_qos_profile_t qos,
                          const rmw_gid_t& gid, const rcl_node_t& node);
  ~IntraProcessPublication();
  IntraProcessPublication(const IntraProcessPublication&) = delete;
  IntraProcessPublication& operator=(const IntraProcessPublication&) = delete;

  /// Subscriptions whose quality of service fits; never null.
  [[nodiscard]] std::shared_ptr<const IntraProcessReach> reach() const;

 private:
  friend class IntraProcessTopic;

  const std::shared_ptr<IntraProcessTopic> topic_;
  const rmw_qos_profile_t qos_;
  const std::array<std::uint8_t, RMW_GID_STORAGE_SIZE> gid_;
  const rcl_node_t& node_;
  std::shared_ptr<const IntraProcessReach> reach_;  // guarded by the topic
};

/// Registration of a subscription; ends with the object. It is made before the subscription's
/// reader exists in the middleware and "settled" afterwards: until then a publisher that finds the
/// numbers differing sends through the middleware as well, and nothing is lost.
class IntraProcessSubscription final {
 public:
  IntraProcessSubscription(std::shared_ptr<IntraProcessTopic> topic, rmw_qos_profile_t qos,
                           std::shared_ptr<IntraProcessInbox> inbox, const rcl_node_t& node);
  ~IntraProcessSubscription();
  IntraProcessSubscription(const IntraProcessSubscription&) = delete;
  IntraProcessSubscription& operator=(const IntraProcessSubscription&) = delete;

  void settle();
  /// Whether that publisher delivers to this topic by pointer, so that its copy that came through
  /// the middleware is to be dropped.
  [[nodiscard]] bool delivered_by_pointer(const rmw_gid_t& publisher) const;

 private:
  friend class IntraProcessTopic;

  const std::shared_ptr<IntraProcessTopic> topic_;
  const rmw_qos_profile_t qos_;
  const std::shared_ptr<IntraProcessInbox> inbox_;
  const rcl_node_t& node_;
  bool settled_ = false;  // guarded by the topic
};

/// Brings publishers and subscriptions of one context together by resolved topic name and message
/// type. Only volatile endpoints with a bounded history take part; all others use the middleware.
class IntraProcessHub {
 public:
  /// Whether an endpoint with that profile can take part.
  [[nodiscard]] static bool suits(const rmw_qos_profile_t& qos) noexcept;

  std::unique_ptr<IntraProcessPublication> add_publisher(const std::string& topic,
                                                         std::type_index type,
                                                         const rmw_qos_profile_t& qos,
                                                         const rmw_gid_t& gid,
                                                         const rcl_node_t& node);
  std::unique_ptr<IntraProcessSubscription> add_subscription(
      const std::string& topic, std::type_index type, const rmw_qos_profile_t& qos,
      std::shared_ptr<IntraProcessInbox> inbox, const rcl_node_t& node);

  /// For a node that cannot be destroyed, as its process died in the constructor: ends its
  /// registrations. Left alone, they would be counted as subscriptions that need no message through
  /// the middleware, which then does not reach others; and their inboxes would stay full.
  void remove_all_of(const rcl_node_t& node);

 private:
  std::shared_ptr<IntraProcessTopic> topic(const std::string& name, std::type_index type);

  std::mutex mutex_;
  std::map<std::pair<std::string, std::type_index>, std::weak_ptr<IntraProcessTopic>> topics_;
};

}  // namespace play_launch
