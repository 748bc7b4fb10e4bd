#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>

namespace play_launch {

class CallbackGroup;
class NodeSlot;
class Waitable;
class WakeToken;

/// Points in time are nanoseconds of the steady clock (CLOCK_MONOTONIC).
using Nanoseconds = std::int64_t;
inline constexpr Nanoseconds kAtOnce = std::numeric_limits<Nanoseconds>::min();
inline constexpr Nanoseconds kNever = std::numeric_limits<Nanoseconds>::max();
[[nodiscard]] Nanoseconds steady_now() noexcept;

/// A counter that threads can wait on. It holds no state that a thread which dies while waiting
/// could leave locked, unlike a condition variable: executors work in processes that share their
/// memory with others and may be killed at any time.
class Doorbell {
 public:
  /// The number to hand to wait(). Read it before looking for work.
  [[nodiscard]] std::uint32_t rings() const noexcept { return rings_.load(); }

  /// Wakes one waiter, or all.
  void ring() noexcept { ring(1); }
  void ring_all() noexcept { ring(std::numeric_limits<int>::max()); }

  /// Returns when it rang since `seen` was read, at `deadline`, or for no reason.
  void wait(std::uint32_t seen, Nanoseconds deadline = kNever) noexcept;

 private:
  void ring(int waiters) noexcept;

  std::atomic<std::uint32_t> rings_{0};
  std::atomic<std::uint32_t> waiters_{0};
};

/// What has become ready for one executor. Producers, among them the middleware's receive threads,
/// never wait for the executor or for each other here.
class ReadyQueue {
 public:
  ReadyQueue() = default;
  ~ReadyQueue();
  ReadyQueue(const ReadyQueue&) = delete;
  ReadyQueue& operator=(const ReadyQueue&) = delete;

  /// Appends a token that is in no queue and wakes one waiter.
  void push(std::shared_ptr<WakeToken> token) noexcept;

  /// All that was pushed since the last call, oldest first, chained by pop_front.
  class Batch {
   public:
    explicit Batch(WakeToken* first) noexcept : first_(first) {}
    ~Batch();
    Batch(const Batch&) = delete;
    Batch& operator=(const Batch&) = delete;
    /// Null when there are no more.
    std::shared_ptr<WakeToken> pop_front() noexcept;

   private:
    WakeToken* first_;
  };
  [[nodiscard]] Batch take_all() noexcept;

  /// The executor is to stop; final. Safe in a signal handler.
  void close() noexcept;
  [[nodiscard]] bool closed() const noexcept { return closed_.load(); }

  [[nodiscard]] Doorbell& doorbell() noexcept { return doorbell_; }

 private:
  std::atomic<WakeToken*> newest_{nullptr};
  std::atomic<bool> closed_{false};
  Doorbell doorbell_;
};

/// A node's place in one executor, from add_node to remove_node.
class NodeSlot {
 public:
  explicit NodeSlot(std::shared_ptr<ReadyQueue> ready) : queue(std::move(ready)) {}

  const std::shared_ptr<ReadyQueue> queue;
  // Guarded by the executor.
  bool removed = false;
  std::size_t running = 0;  // callbacks
};

/// Stands for a waitable wherever the waitable itself must not be kept alive: in the queues of an
/// executor and in the hands of those who notify.
class WakeToken : public std::enable_shared_from_this<WakeToken> {
 public:
  WakeToken(bool is_timed, std::shared_ptr<CallbackGroup> callback_group)
      : timed(is_timed), group(std::move(callback_group)) {}

  /// Has the executor look at the waitable; nothing when it is in no executor. Any thread.
  void notify(std::size_t new_events) noexcept;

  /// Which waitable it stands for; once, before attach().
  void bind(std::weak_ptr<Waitable> waitable);
  /// Notifications go to that executor from now on; the first one is given here.
  void attach(const std::shared_ptr<NodeSlot>& slot);
  /// Notifications go nowhere from now on.
  void detach();
  [[nodiscard]] std::shared_ptr<NodeSlot> slot() const;
  /// Null when the waitable is gone.
  [[nodiscard]] std::shared_ptr<Waitable> lock() const { return waitable_.lock(); }

  const bool timed;
  const std::shared_ptr<CallbackGroup> group;

  /// Set by whoever puts the token into a queue, cleared when it is taken out to be worked on: a
  /// token is in at most one place.
  std::atomic<bool> queued{false};
  /// Notified since the last look; a hint, the middleware may have replaced messages.
  std::atomic<std::size_t> events{0};
  /// For timed ones: when to look.
  std::atomic<Nanoseconds> due{kAtOnce};
  /// The waitable is being destroyed.
  std::atomic<bool> retired{false};

  // Guarded by the executor: under which time the token is among the timers.
  std::optional<Nanoseconds> armed;

 private:
  friend class ReadyQueue;

  mutable std::mutex mutex_;
  std::shared_ptr<NodeSlot> slot_;
  std::weak_ptr<Waitable> waitable_;
  // Owned by the queue the token is in.
  WakeToken* next_ = nullptr;
  std::shared_ptr<WakeToken> self_;
};

/// A token on its way through an executor.
struct ReadyEntry {
  std::shared_ptr<WakeToken> token;
  std::shared_ptr<NodeSlot> slot;
};

}  // namespace play_launch
