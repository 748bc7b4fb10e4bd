#pragma once

#include <deque>
#include <map>
#include <memory>
#include <utility>

#include "ready_queue.hpp"

namespace play_launch {

/// Decides what an executor runs next. First come, first served among callback groups: a mutually
/// exclusive group queues once, with its next entry, and queues again behind all others after its
/// turn; an entry of a reentrant group queues by itself. Not thread-safe: the executor guards it.
class Scheduler {
 public:
  explicit Scheduler(std::shared_ptr<ReadyQueue> queue) : queue_(std::move(queue)) {}

  /// Moves what was notified and what is due by now to where next() finds it.
  void collect();

  /// The next entry to run, which then counts as running; false when there is none. finish() must
  /// follow.
  bool next(ReadyEntry& entry);

  /// The entry's turn is over. `look_again` when it may have more to take.
  void finish(const ReadyEntry& entry, bool look_again);

  /// Forgets all of a removed node whose tokens have been detached.
  void purge(const NodeSlot& slot);

  [[nodiscard]] bool has_runnable() const noexcept { return !runnable_.empty(); }
  /// When the next timer is due; kNever when there is none.
  [[nodiscard]] Nanoseconds next_deadline() const noexcept;

 private:
  /// One of the two is set.
  struct Turn {
    std::shared_ptr<CallbackGroup> group;
    ReadyEntry entry;
  };

  void admit(ReadyEntry entry, Nanoseconds now);
  void schedule(ReadyEntry entry);
  void arm(const ReadyEntry& entry, Nanoseconds due);
  void disarm(WakeToken& token);
  static void drop_waiting(CallbackGroup& group, const NodeSlot& slot);

  const std::shared_ptr<ReadyQueue> queue_;
  std::deque<Turn> runnable_;
  std::map<std::pair<Nanoseconds, const WakeToken*>, ReadyEntry> timers_;
};

}  // namespace play_launch
