#include "ready_queue.hpp"

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <chrono>
#include <ctime>
#include <utility>

namespace play_launch {

static_assert(std::atomic<std::uint32_t>::is_always_lock_free &&
              sizeof(std::atomic<std::uint32_t>) == sizeof(std::uint32_t));

Nanoseconds steady_now() noexcept {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

void Doorbell::ring(int waiters) noexcept {
  rings_.fetch_add(1);
  if (waiters_.load() == 0) return;
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&rings_), FUTEX_WAKE_PRIVATE, waiters,
          nullptr, nullptr, 0);
}

void Doorbell::wait(std::uint32_t seen, Nanoseconds deadline) noexcept {
  constexpr Nanoseconds kSecond = 1'000'000'000;
  timespec until{};
  const timespec* timeout = nullptr;
  if (deadline != kNever) {
    const Nanoseconds at = deadline < 0 ? 0 : deadline;
    until.tv_sec = at / kSecond;
    until.tv_nsec = at % kSecond;
    timeout = &until;
  }
  waiters_.fetch_add(1);
  // The bitset form takes an absolute time, by CLOCK_MONOTONIC.
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&rings_), FUTEX_WAIT_BITSET_PRIVATE, seen,
          timeout, nullptr, FUTEX_BITSET_MATCH_ANY);
  waiters_.fetch_sub(1);
}

ReadyQueue::~ReadyQueue() { static_cast<void>(take_all()); }

void ReadyQueue::push(std::shared_ptr<WakeToken> token) noexcept {
  WakeToken* const raw = token.get();
  raw->self_ = std::move(token);
  WakeToken* newest = newest_.load(std::memory_order_relaxed);
  do {
    raw->next_ = newest;
  } while (!newest_.compare_exchange_weak(newest, raw));
  doorbell_.ring();
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

void ReadyQueue::close() noexcept {
  closed_.store(true);
  doorbell_.ring_all();
}

void WakeToken::notify(std::size_t new_events) noexcept {
  events.fetch_add(new_events);
  if (queued.exchange(true)) return;
  const std::lock_guard lock(mutex_);
  if (slot_ == nullptr) {
    // attach() looks for itself, so nothing is lost.
    queued.store(false);
    return;
  }
  slot_->queue->push(shared_from_this());
}

void WakeToken::bind(std::weak_ptr<Waitable> waitable) {
  const std::lock_guard lock(mutex_);
  waitable_ = std::move(waitable);
}

void WakeToken::attach(const std::shared_ptr<NodeSlot>& slot) {
  {
    const std::lock_guard lock(mutex_);
    slot_ = slot;
  }
  // Something may have arrived before.
  notify(0);
}

void WakeToken::detach() {
  const std::lock_guard lock(mutex_);
  slot_ = nullptr;
}

std::shared_ptr<NodeSlot> WakeToken::slot() const {
  const std::lock_guard lock(mutex_);
  return slot_;
}

}  // namespace play_launch
