#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <play_launch/detail/stop_flag.hpp>
#include <utility>
#include <vector>

namespace play_launch {

class CallbackGroup;
class NodeSlot;
class Waitable;
class WakeToken;

[[nodiscard]] Nanoseconds steady_now() noexcept;

/// What has become ready for one executor. Producers, among them the middleware's receive threads,
/// never wait for the executor or for each other here: they take no lock, which a thread of the
/// executor could hold when its process is killed.
class ReadyQueue {
 public:
  explicit ReadyQueue(std::shared_ptr<detail::StopFlag> stop) : stop_(std::move(stop)) {}
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

  /// Closed: what is here, and what a thread is about to push, is released.
  void retire() noexcept;

  /// The request to the executor to stop.
  [[nodiscard]] const std::shared_ptr<detail::StopFlag>& stop() const noexcept { return stop_; }

  /// Rings with every push, and with the request to stop.
  [[nodiscard]] detail::Doorbell& doorbell() const noexcept { return stop_->doorbell(); }

 private:
  void let_go() noexcept;

  std::atomic<WakeToken*> newest_{nullptr};
  std::atomic<bool> retired_{false};
  const std::shared_ptr<detail::StopFlag> stop_;
};

/// A node's place in one executor, from add_node to remove_node.
class NodeSlot : public std::enable_shared_from_this<NodeSlot> {
 public:
  explicit NodeSlot(std::shared_ptr<ReadyQueue> ready) : queue(std::move(ready)) {}

  const std::shared_ptr<ReadyQueue> queue;
  // Guarded by the executor.
  bool removed = false;
  std::size_t running = 0;  // callbacks
};

/// Stands for a waitable wherever the waitable itself must not be kept alive: in the queues of an
/// executor and in the hands of notifiers.
class WakeToken : public std::enable_shared_from_this<WakeToken> {
 public:
  WakeToken(bool is_timed, std::shared_ptr<CallbackGroup> callback_group)
      : timed(is_timed), group(std::move(callback_group)) {}

  /// Has the executor look at the waitable; nothing when it is in no executor. Any thread.
  void notify(std::size_t new_events) noexcept;

  /// Which waitable it stands for; once, before attach().
  void bind(std::weak_ptr<Waitable> waitable);
  /// Notifications go to that executor from now on; the first one is given here. One thread at a
  /// time.
  void attach(std::shared_ptr<NodeSlot> slot);
  /// Notifications go nowhere from now on, but for those that are under way: `queue` may still get
  /// one.
  void detach() noexcept { slot_.store(nullptr); }
  /// Null when it is in no executor.
  [[nodiscard]] std::shared_ptr<NodeSlot> slot() const;
  /// It was taken from that queue, where no thread handles it.
  void leave(const ReadyQueue& queue) noexcept;
  /// Null when the waitable is gone.
  [[nodiscard]] std::shared_ptr<Waitable> lock() const { return waitable_.lock(); }

  const bool timed;
  const std::shared_ptr<CallbackGroup> group;

  /// Set by the thread that puts the token into a queue, cleared when it is taken out to be worked
  /// on: a token is in at most one place.
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

  std::atomic<NodeSlot*> slot_{nullptr};
  // All that slot_ ever was, for threads that have just read it: one for each executor that had the
  // node.
  std::vector<std::shared_ptr<NodeSlot>> slots_;
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

class NodeSlot;
class Waitable;
class WakeToken;

/// What a node has for executors, and which executor the node is in.
class WaitableRegistry {
 public:
  /// Adds a waitable, for the executor too if there is one.
  void add(const std::shared_ptr<Waitable>& waitable);

  /// Claims the node for an executor. Throws std::logic_error when another has it.
  void hold();
  /// Connects all present and future waitables to that place in the executor.
  void attach(std::shared_ptr<NodeSlot> slot);
  /// Disconnects all. The node stays claimed until release().
  void detach();
  void release();

 private:
  std::mutex mutex_;
  bool held_ = false;
  std::shared_ptr<NodeSlot> slot_;
  std::vector<std::shared_ptr<WakeToken>> tokens_;
  std::size_t prune_at_ = 32;
};

}  // namespace play_launch
