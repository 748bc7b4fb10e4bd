#pragma once

#include <rmw/types.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <play_launch/detail/construction.hpp>
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

  /// The oldest message; false when there is none.
  bool take(Item& item) {
    const std::lock_guard lock(mutex_);
    if (items_.empty()) return false;
    item = std::move(items_.front());
    items_.pop_front();
    return true;
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
class IntraProcessPublication final : private Discardable {
 public:
  IntraProcessPublication(std::shared_ptr<IntraProcessTopic> topic, rmw_qos_profile_t qos,
                          const rmw_gid_t& gid);
  ~IntraProcessPublication();

  /// Subscriptions whose quality of service fits; never null.
  [[nodiscard]] std::shared_ptr<const IntraProcessReach> reach() const;

 private:
  friend class IntraProcessTopic;
  void discard() noexcept override;

  const std::shared_ptr<IntraProcessTopic> topic_;
  const rmw_qos_profile_t qos_;
  const std::array<std::uint8_t, RMW_GID_STORAGE_SIZE> gid_;
  std::shared_ptr<const IntraProcessReach> reach_;  // guarded by the topic
};

/// Registration of a subscription; ends with the object. It is made before the subscription's
/// reader exists in the middleware and "settled" afterwards: until then a publisher that finds the
/// numbers differing sends through the middleware as well, and nothing is lost.
class IntraProcessSubscription final : private Discardable {
 public:
  IntraProcessSubscription(std::shared_ptr<IntraProcessTopic> topic, rmw_qos_profile_t qos,
                           std::shared_ptr<IntraProcessInbox> inbox);
  ~IntraProcessSubscription();

  void settle();
  /// Whether that publisher delivers to this topic by pointer, so that its copy that came through
  /// the middleware is to be dropped.
  [[nodiscard]] bool delivered_by_pointer(const rmw_gid_t& publisher) const;

 private:
  friend class IntraProcessTopic;
  void discard() noexcept override;

  const std::shared_ptr<IntraProcessTopic> topic_;
  const rmw_qos_profile_t qos_;
  const std::shared_ptr<IntraProcessInbox> inbox_;
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
                                                         const rmw_gid_t& gid);
  std::unique_ptr<IntraProcessSubscription> add_subscription(
      const std::string& topic, std::type_index type, const rmw_qos_profile_t& qos,
      std::shared_ptr<IntraProcessInbox> inbox);

 private:
  std::shared_ptr<IntraProcessTopic> topic(const std::string& name, std::type_index type);

  std::mutex mutex_;
  std::map<std::pair<std::string, std::type_index>, std::weak_ptr<IntraProcessTopic>> topics_;
};

}  // namespace play_launch
