#include <rmw/error_handling.h>
#include <rmw/qos_profiles.h>
#include <rmw/rmw.h>

#include <algorithm>
#include <cstring>
#include <play_launch/detail/intra_process.hpp>

#include "ready_queue.hpp"

namespace play_launch {
namespace {

bool compatible(const rmw_qos_profile_t& publisher, const rmw_qos_profile_t& subscription) {
  rmw_qos_compatibility_type_t compatibility = RMW_QOS_COMPATIBILITY_ERROR;
  if (rmw_qos_profile_check_compatible(publisher, subscription, &compatibility, nullptr, 0) !=
      RMW_RET_OK) {
    rmw_reset_error();
    return false;
  }
  return compatibility != RMW_QOS_COMPATIBILITY_ERROR;
}

std::array<std::uint8_t, RMW_GID_STORAGE_SIZE> bytes_of(const rmw_gid_t& gid) {
  std::array<std::uint8_t, RMW_GID_STORAGE_SIZE> bytes;
  std::memcpy(bytes.data(), gid.data, bytes.size());
  return bytes;
}

}  // namespace

/// All publishers and subscriptions of one topic and type. Publishers read a snapshot that is
/// remade when anything changes, so that publishing costs one short lock.
class IntraProcessTopic {
 public:
  void add(IntraProcessPublication& publication) {
    const std::lock_guard lock(mutex_);
    publications_.push_back(&publication);
    remake(publication);
  }

  void add(IntraProcessSubscription& subscription) {
    const std::lock_guard lock(mutex_);
    subscriptions_.push_back(&subscription);
    remake_all();
  }

  void remove(const IntraProcessPublication& publication) {
    const std::lock_guard lock(mutex_);
    std::erase(publications_, &publication);
  }

  void remove(const IntraProcessSubscription& subscription) {
    const std::lock_guard lock(mutex_);
    std::erase(subscriptions_, &subscription);
    remake_all();
  }

  void remove_all_of(const rcl_node_t& node) {
    std::vector<std::shared_ptr<IntraProcessInbox>> inboxes;
    {
      const std::lock_guard lock(mutex_);
      std::erase_if(publications_, [&](const auto* entry) { return &entry->node_ == &node; });
      std::erase_if(subscriptions_, [&](const auto* entry) {
        const bool is_its = &entry->node_ == &node;
        if (is_its) inboxes.push_back(entry->inbox_);
        return is_its;
      });
      if (!inboxes.empty()) remake_all();
    }
    for (const auto& inbox : inboxes) inbox->clear();
  }

  void settle(IntraProcessSubscription& subscription) {
    const std::lock_guard lock(mutex_);
    subscription.settled_ = true;
    remake_all();
  }

  std::shared_ptr<const IntraProcessReach> reach(const IntraProcessPublication& publication) {
    const std::lock_guard lock(mutex_);
    return publication.reach_;
  }

  bool has_publisher(const rmw_gid_t& gid) {
    const auto wanted = bytes_of(gid);
    const std::lock_guard lock(mutex_);
    return std::any_of(publications_.begin(), publications_.end(),
                       [&wanted](const auto* publication) { return publication->gid_ == wanted; });
  }

 private:
  void remake_all() {
    for (auto* publication : publications_) remake(*publication);
  }

  void remake(IntraProcessPublication& publication) {
    auto reach = std::make_shared<IntraProcessReach>();
    for (const auto* subscription : subscriptions_) {
      if (!compatible(publication.qos_, subscription->qos_)) continue;
      reach->inboxes.push_back(subscription->inbox_);
      if (subscription->settled_) ++reach->settled;
    }
    publication.reach_ = std::move(reach);
  }

  std::mutex mutex_;
  std::vector<IntraProcessPublication*> publications_;
  std::vector<IntraProcessSubscription*> subscriptions_;
};

IntraProcessInbox::IntraProcessInbox(std::size_t depth, bool takes_ownership,
                                     std::shared_ptr<WakeToken> token)
    : depth_(depth), takes_ownership_(takes_ownership), token_(std::move(token)) {}

IntraProcessInbox::~IntraProcessInbox() = default;

void IntraProcessInbox::wake() noexcept { token_->notify(1); }

IntraProcessPublication::IntraProcessPublication(std::shared_ptr<IntraProcessTopic> topic,
                                                 rmw_qos_profile_t qos, const rmw_gid_t& gid,
                                                 const rcl_node_t& node)
    : topic_(std::move(topic)), qos_(qos), gid_(bytes_of(gid)), node_(node) {
  topic_->add(*this);
}

IntraProcessPublication::~IntraProcessPublication() { topic_->remove(*this); }

std::shared_ptr<const IntraProcessReach> IntraProcessPublication::reach() const {
  return topic_->reach(*this);
}

IntraProcessSubscription::IntraProcessSubscription(std::shared_ptr<IntraProcessTopic> topic,
                                                   rmw_qos_profile_t qos,
                                                   std::shared_ptr<IntraProcessInbox> inbox,
                                                   const rcl_node_t& node)
    : topic_(std::move(topic)), qos_(qos), inbox_(std::move(inbox)), node_(node) {
  topic_->add(*this);
}

IntraProcessSubscription::~IntraProcessSubscription() { topic_->remove(*this); }

void IntraProcessSubscription::settle() { topic_->settle(*this); }

bool IntraProcessSubscription::delivered_by_pointer(const rmw_gid_t& publisher) const {
  return topic_->has_publisher(publisher);
}

bool IntraProcessHub::suits(const rmw_qos_profile_t& qos) noexcept {
  return qos.durability == RMW_QOS_POLICY_DURABILITY_VOLATILE &&
         qos.history == RMW_QOS_POLICY_HISTORY_KEEP_LAST && qos.depth > 0;
}

std::shared_ptr<IntraProcessTopic> IntraProcessHub::topic(const std::string& name,
                                                          std::type_index type) {
  const std::lock_guard lock(mutex_);
  auto& known = topics_[{name, type}];
  if (auto topic = known.lock()) return topic;
  std::erase_if(topics_, [&known](const auto& entry) {
    return &entry.second != &known && entry.second.expired();
  });
  auto topic = std::make_shared<IntraProcessTopic>();
  known = topic;
  return topic;
}

std::unique_ptr<IntraProcessPublication> IntraProcessHub::add_publisher(
    const std::string& name, std::type_index type, const rmw_qos_profile_t& qos,
    const rmw_gid_t& gid, const rcl_node_t& node) {
  return std::make_unique<IntraProcessPublication>(topic(name, type), qos, gid, node);
}

std::unique_ptr<IntraProcessSubscription> IntraProcessHub::add_subscription(
    const std::string& name, std::type_index type, const rmw_qos_profile_t& qos,
    std::shared_ptr<IntraProcessInbox> inbox, const rcl_node_t& node) {
  return std::make_unique<IntraProcessSubscription>(topic(name, type), qos, std::move(inbox), node);
}

void IntraProcessHub::remove_all_of(const rcl_node_t& node) {
  std::vector<std::shared_ptr<IntraProcessTopic>> topics;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [key, known] : topics_) {
      if (auto topic = known.lock()) topics.push_back(std::move(topic));
    }
  }
  for (const auto& topic : topics) topic->remove_all_of(node);
}

}  // namespace play_launch
