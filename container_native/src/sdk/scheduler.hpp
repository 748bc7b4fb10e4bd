#pragma once

#include <pthread.h>

#include <deque>
#include <list>
#include <map>
#include <memory>
#include <play_launch/detail/waitable.hpp>
#include <utility>

#include "ready_queue.hpp"

namespace play_launch {

/// A turn that was given and is not over. Kept here and not on the stack of the thread that runs
/// it, so that everything can be released when that thread dies with its process.
struct RunningTurn {
  ReadyEntry entry;
  pthread_t thread;
  // Touched by the running thread only.
  std::shared_ptr<Waitable> waitable;
  Work work;
};

/// Decides what an executor runs next. First come, first served among callback groups: a mutually
/// exclusive group queues once, with its next entry, and queues again behind all others after its
/// turn; an entry of a reentrant group has a queue of its own. Not thread-safe: the executor guards
/// it.
class Scheduler {
 public:
  explicit Scheduler(std::shared_ptr<ReadyQueue> queue) : queue_(std::move(queue)) {}

  /// Moves what was notified and what is due by now to where next() finds it.
  void collect();

  /// Gives the next turn to the calling thread; null when there is nothing to run. finish() must
  /// follow.
  RunningTurn* next();

  /// The turn is over; the caller has released its waitable and work. `look_again` when there may
  /// be more to take.
  void finish(RunningTurn& turn, bool look_again);

  /// Ends all turns that were given, whose threads are gone. Returns what they held, to be
  /// destroyed without the executor's lock.
  [[nodiscard]] std::list<RunningTurn> abandon();

  /// Whether the calling thread has a turn of that node.
  [[nodiscard]] bool runs_in_this_thread(const NodeSlot& slot) const noexcept;

  /// Forgets all of a removed node whose tokens have been detached.
  void purge(const NodeSlot& slot);

  [[nodiscard]] bool has_runnable() const noexcept { return !runnable_.empty(); }
  /// When the next timer is due; kNever without timers.
  [[nodiscard]] Nanoseconds next_deadline() const noexcept;

 private:
  /// One of the two is set.
  struct Turn {
    std::shared_ptr<CallbackGroup> group;
    ReadyEntry entry;
  };

  void admit(ReadyEntry entry, Nanoseconds now);
  void schedule(ReadyEntry entry);
  void end_turn(const ReadyEntry& entry, bool look_again);
  void arm(const ReadyEntry& entry, Nanoseconds due);
  void disarm(WakeToken& token);
  static void drop_waiting(CallbackGroup& group, const NodeSlot& slot);

  const std::shared_ptr<ReadyQueue> queue_;
  std::deque<Turn> runnable_;
  std::map<std::pair<Nanoseconds, const WakeToken*>, ReadyEntry> timers_;
  std::list<RunningTurn> running_;
  std::list<RunningTurn> spare_;  // so that giving a turn allocates nothing
};

}  // namespace play_launch
