#include "waitable_registry.hpp"

#include <play_launch/detail/waitable.hpp>
#include <stdexcept>
#include <utility>

#include "ready_queue.hpp"

namespace play_launch {

void WaitableRegistry::add(const std::shared_ptr<Waitable>& waitable) {
  const auto& token = waitable->token();
  token->bind(waitable);
  const std::lock_guard lock(mutex_);
  if (tokens_.size() >= prune_at_) {
    std::erase_if(tokens_, [](const auto& known) { return known->retired.load(); });
    prune_at_ = 2 * tokens_.size() + 32;
  }
  tokens_.push_back(token);
  if (slot_) token->attach(slot_);
}

void WaitableRegistry::hold() {
  const std::lock_guard lock(mutex_);
  if (held_) throw std::logic_error("add_node: the node is in an executor already");
  held_ = true;
}

void WaitableRegistry::attach(std::shared_ptr<NodeSlot> slot) {
  const std::lock_guard lock(mutex_);
  slot_ = std::move(slot);
  for (const auto& token : tokens_) token->attach(slot_);
}

void WaitableRegistry::detach() {
  const std::lock_guard lock(mutex_);
  slot_ = nullptr;
  for (const auto& token : tokens_) token->detach();
}

void WaitableRegistry::release() {
  const std::lock_guard lock(mutex_);
  held_ = false;
}

}  // namespace play_launch
