#include "ready_queue.hpp"

#include <chrono>
#include <play_launch/detail/waitable.hpp>
#include <stdexcept>
#include <utility>

namespace play_launch {

Nanoseconds steady_now() noexcept {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

ReadyQueue::~ReadyQueue() { static_cast<void>(take_all()); }

void ReadyQueue::push(std::shared_ptr<WakeToken> token) noexcept {
  WakeToken* const raw = token.get();
  raw->self_ = std::move(token);
  WakeToken* newest = newest_.load(std::memory_order_relaxed);
  do {
    raw->next_ = newest;
  } while (!newest_.compare_exchange_weak(newest, raw));
  doorbell().ring();
  if (retired_.load()) let_go();
}

ReadyQueue::Batch ReadyQueue::take_all() noexcept {
  WakeToken* newest = newest_.exchange(nullptr);
  WakeToken* oldest = nullptr;
  while (newest != nullptr) {
    WakeToken* const older = newest->next_;
    newest->next_ = oldest;
    oldest = newest;
    newest = older;
  }
  return Batch(oldest);
}

ReadyQueue::Batch::~Batch() {
  while (pop_front()) {
  }
}

std::shared_ptr<WakeToken> ReadyQueue::Batch::pop_front() noexcept {
  if (first_ == nullptr) return nullptr;
  return std::move(std::exchange(first_, first_->next_)->self_);
}

void ReadyQueue::retire() noexcept {
  retired_.store(true);
  let_go();
}

void ReadyQueue::let_go() noexcept {
  auto batch = take_all();
  while (const auto token = batch.pop_front()) token->leave(*this);
}

// A notifier marks the token and then reads the slot; an attaching thread writes the slot and looks
// at the mark. So one of the two sees the other, and nothing is lost.
void WakeToken::notify(std::size_t new_events) noexcept {
  events.fetch_add(new_events);
  while (!queued.exchange(true)) {
    if (const NodeSlot* const slot = slot_.load()) {
      slot->queue->push(shared_from_this());
      return;
    }
    queued.store(false);
    if (slot_.load() == nullptr) return;
  }
}

void WakeToken::bind(std::weak_ptr<Waitable> waitable) { waitable_ = std::move(waitable); }

void WakeToken::attach(std::shared_ptr<NodeSlot> slot) {
  slots_.push_back(std::move(slot));
  slot_.store(slots_.back().get());
  // Something may have arrived before.
  notify(0);
}

std::shared_ptr<NodeSlot> WakeToken::slot() const {
  NodeSlot* const slot = slot_.load();
  return slot != nullptr ? slot->shared_from_this() : nullptr;
}

void WakeToken::leave(const ReadyQueue& queue) noexcept {
  queued.store(false);
  const NodeSlot* const slot = slot_.load();
  if (slot != nullptr && slot->queue.get() != &queue) notify(0);
}

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
