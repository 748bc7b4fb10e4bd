#include "scheduler.hpp"

#include <algorithm>
#include <play_launch/callback_group.hpp>

namespace play_launch {

CallbackGroup::CallbackGroup(Kind kind) : kind_(kind) {}
CallbackGroup::~CallbackGroup() = default;

void Scheduler::collect() {
  const Nanoseconds now = steady_now();
  auto batch = queue_->take_all();
  while (auto token = batch.pop_front()) {
    auto slot = token->slot();
    if (slot == nullptr || slot->queue != queue_ || slot->removed) {
      token->leave(*queue_);
      continue;
    }
    admit({std::move(token), std::move(slot)}, now);
  }
  while (!timers_.empty() && timers_.begin()->first.first <= now) {
    ReadyEntry entry = std::move(timers_.begin()->second);
    timers_.erase(timers_.begin());
    entry.token->armed.reset();
    // Already queued means it is looked at anyway.
    if (!entry.token->queued.exchange(true)) admit(std::move(entry), now);
  }
}

// The token is marked as queued; it either gets a turn or is unmarked.
void Scheduler::admit(ReadyEntry entry, Nanoseconds now) {
  WakeToken& token = *entry.token;
  if (token.retired.load()) {
    disarm(token);
    token.queued.store(false);
    return;
  }
  if (token.timed) {
    // Unmark before reading, or a change of the time in between would be missed.
    token.queued.store(false);
    const Nanoseconds due = token.due.load();
    if (due > now) {
      arm(entry, due);
      return;
    }
    if (token.queued.exchange(true)) return;
    disarm(token);
  }
  schedule(std::move(entry));
}

void Scheduler::schedule(ReadyEntry entry) {
  const auto& group = entry.token->group;
  if (group->kind() == CallbackGroup::Kind::reentrant) {
    runnable_.push_back({nullptr, std::move(entry)});
    return;
  }
  if (!group->scheduled_) {
    group->scheduled_ = true;
    runnable_.push_back({group, {}});
  }
  group->waiting_.push_back(std::move(entry));
}

RunningTurn* Scheduler::next() {
  if (runnable_.empty()) return nullptr;
  if (spare_.empty()) spare_.emplace_back();
  running_.splice(running_.end(), spare_, spare_.begin());
  RunningTurn& running = running_.back();
  Turn turn = std::move(runnable_.front());
  runnable_.pop_front();
  if (turn.group) {
    running.entry = std::move(turn.group->waiting_.front());
    turn.group->waiting_.pop_front();
  } else {
    running.entry = std::move(turn.entry);
  }
  running.thread = pthread_self();
  ++running.entry.slot->running;
  running.entry.token->queued.store(false);
  return &running;
}

void Scheduler::finish(RunningTurn& turn, bool look_again) {
  end_turn(turn.entry, look_again);
  turn.entry = {};
  const auto here = std::find_if(running_.begin(), running_.end(),
                                 [&turn](const RunningTurn& known) { return &known == &turn; });
  spare_.splice(spare_.end(), running_, here);
}

std::list<RunningTurn> Scheduler::abandon() {
  for (const auto& turn : running_) end_turn(turn.entry, false);
  return std::exchange(running_, {});
}

bool Scheduler::runs_in_this_thread(const NodeSlot& slot) const noexcept {
  return std::any_of(running_.begin(), running_.end(), [&slot](const RunningTurn& turn) {
    return turn.entry.slot.get() == &slot && pthread_equal(turn.thread, pthread_self()) != 0;
  });
}

void Scheduler::end_turn(const ReadyEntry& entry, bool look_again) {
  --entry.slot->running;
  CallbackGroup& group = *entry.token->group;
  if (entry.slot->removed) {
    drop_waiting(group, *entry.slot);
  } else if (look_again && !entry.token->queued.exchange(true)) {
    admit(entry, steady_now());
  }
  if (group.kind() == CallbackGroup::Kind::reentrant) return;
  if (group.waiting_.empty()) {
    group.scheduled_ = false;
  } else {
    runnable_.push_back({entry.token->group, {}});
  }
}

void Scheduler::purge(const NodeSlot& slot) {
  collect();  // notified before they were detached
  std::deque<Turn> kept;
  for (auto& turn : runnable_) {
    if (turn.group) {
      drop_waiting(*turn.group, slot);
      if (turn.group->waiting_.empty()) {
        turn.group->scheduled_ = false;
        continue;
      }
    } else if (turn.entry.slot.get() == &slot) {
      turn.entry.token->queued.store(false);
      continue;
    }
    kept.push_back(std::move(turn));
  }
  runnable_ = std::move(kept);
  std::erase_if(timers_, [&slot](const auto& timer) {
    if (timer.second.slot.get() != &slot) return false;
    timer.second.token->armed.reset();
    return true;
  });
}

void Scheduler::drop_waiting(CallbackGroup& group, const NodeSlot& slot) {
  group.waiting_.remove_if([&slot](const ReadyEntry& waiting) {
    if (waiting.slot.get() != &slot) return false;
    waiting.token->queued.store(false);
    return true;
  });
}

void Scheduler::arm(const ReadyEntry& entry, Nanoseconds due) {
  WakeToken& token = *entry.token;
  if (token.armed == due) return;
  disarm(token);
  if (due == kNever) return;
  timers_.emplace(std::pair(due, &token), entry);
  token.armed = due;
}

void Scheduler::disarm(WakeToken& token) {
  if (!token.armed) return;
  timers_.erase(std::pair(*token.armed, static_cast<const WakeToken*>(&token)));
  token.armed.reset();
}

Nanoseconds Scheduler::next_deadline() const noexcept {
  return timers_.empty() ? kNever : timers_.begin()->first.first;
}

}  // namespace play_launch
