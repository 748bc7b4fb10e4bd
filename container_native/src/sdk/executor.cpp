#include <algorithm>
#include <exception>
#include <list>
#include <map>
#include <memory>
#include <play_launch/callback_group.hpp>
#include <play_launch/context.hpp>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/detail/forget.hpp>
#include <play_launch/detail/running_node.hpp>
#include <play_launch/executor.hpp>
#include <play_launch/node.hpp>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

#include "ready_queue.hpp"
#include "scheduler.hpp"

namespace play_launch {

struct ExecutorState {
  struct Held {
    std::shared_ptr<Node> node;
    std::shared_ptr<NodeSlot> slot;
  };

  explicit ExecutorState(std::shared_ptr<detail::StopFlag> stop)
      : queue(std::make_shared<ReadyQueue>(std::move(stop))) {}

  const std::shared_ptr<ReadyQueue> queue;
  std::mutex mutex;
  // Guarded by the mutex from here on.
  Scheduler scheduler{queue};
  std::map<const Node*, Held> nodes;
  bool spinning = false;
  std::size_t idle = 0;
  // Until when the one idle worker sleeps that looks after the timers; kNever when none does.
  Nanoseconds timekeeper = kNever;
  // Where to note when a thread looked for work; null: nowhere. Set before spin().
  std::atomic<Nanoseconds>* beat = nullptr;
  std::span<std::atomic<Nanoseconds>> takes;
  // Rings when the last callback of a removed node has returned.
  detail::Doorbell quiet;
};

namespace {

/// What goes wrong here is the middleware's; the node can do nothing about it.
/// Notes a take in the first free place; one that finds none is not noted.
class TakeNote {
 public:
  explicit TakeNote(std::span<std::atomic<Nanoseconds>> places) noexcept {
    for (std::atomic<Nanoseconds>& place : places) {
      Nanoseconds free = 0;
      if (place.compare_exchange_strong(free, steady_now(), std::memory_order_relaxed)) {
        place_ = &place;
        return;
      }
    }
  }
  ~TakeNote() {
    if (place_ != nullptr) place_->store(0, std::memory_order_relaxed);
  }
  TakeNote(const TakeNote&) = delete;
  TakeNote& operator=(const TakeNote&) = delete;

 private:
  std::atomic<Nanoseconds>* place_ = nullptr;
};

Work take_or_report(Waitable& waitable, std::span<std::atomic<Nanoseconds>> takes) {
  const TakeNote note(takes);
  try {
    return waitable.take();
  } catch (const std::exception& error) {
    PLAY_LAUNCH_ERROR(waitable.logger(), "%s", error.what());
    return Work();
  }
}

}  // namespace

Executor::Executor(std::shared_ptr<detail::StopFlag> stop)
    : state_(std::make_unique<ExecutorState>(std::move(stop))) {}

Executor::~Executor() {
  while (true) {
    std::shared_ptr<Node> node;
    {
      const std::lock_guard lock(state_->mutex);
      if (state_->nodes.empty()) break;
      node = state_->nodes.begin()->second.node;
    }
    remove_node(node);
  }
  state_->queue->retire();
}

void Executor::cancel() noexcept { state_->queue->stop()->set(); }

void detail::ExecutorAccess::beat_into(Executor& executor, std::atomic<std::int64_t>& beat,
                                       std::span<std::atomic<std::int64_t>> takes) noexcept {
  executor.state_->beat = &beat;
  executor.state_->takes = takes;
  beat = steady_now();
}

void detail::ExecutorAccess::abandon(Executor& executor) { executor.abandon(); }

std::unique_ptr<Executor> detail::ExecutorAccess::single_threaded(std::shared_ptr<StopFlag> stop) {
  return std::unique_ptr<Executor>(new SingleThreadedExecutor(std::move(stop)));
}

std::unique_ptr<Executor> detail::ExecutorAccess::multi_threaded(std::size_t threads,
                                                                 std::shared_ptr<StopFlag> stop) {
  return std::unique_ptr<Executor>(new MultiThreadedExecutor(threads, std::move(stop)));
}

void Executor::add_node(std::shared_ptr<Node> node) {
  if (!node) throw std::invalid_argument("add_node: no node");
  auto slot = std::make_shared<NodeSlot>(state_->queue);
  node->waitables_->hold();
  {
    const std::lock_guard lock(state_->mutex);
    state_->nodes.emplace(node.get(), ExecutorState::Held{node, slot});
  }
  detail::ContextAccess::stop_on_shutdown(*node->context(), state_->queue->stop());
  node->waitables_->attach(slot);
}

void Executor::remove_node(const std::shared_ptr<Node>& node) {
  std::unique_lock lock(state_->mutex);
  const auto found = state_->nodes.find(node.get());
  if (found == state_->nodes.end()) return;
  if (state_->scheduler.runs_in_this_thread(*found->second.slot)) {
    throw std::logic_error("remove_node: called from a callback of that node");
  }
  const ExecutorState::Held held = std::move(found->second);
  state_->nodes.erase(found);
  held.slot->removed = true;
  lock.unlock();

  held.node->waitables_->detach();

  lock.lock();
  state_->scheduler.purge(*held.slot);
  while (held.slot->running != 0) {
    const auto seen = state_->quiet.rings();
    lock.unlock();
    state_->quiet.wait(seen);
    lock.lock();
  }
  lock.unlock();
  held.node->waitables_->release();
}

void Executor::work() {
  std::unique_lock lock(state_->mutex);
  while (true) {
    // Read before looking: what comes later makes wait_for_work return at once.
    const auto seen = state_->queue->doorbell().rings();
    if (state_->queue->stop()->is_set()) return;
    state_->scheduler.collect();
    if (state_->beat != nullptr) state_->beat->store(steady_now(), std::memory_order_relaxed);
    RunningTurn* const turn = state_->scheduler.next();
    if (turn == nullptr) {
      wait_for_work(seen, lock);
      continue;
    }
    const bool hand_over =
        state_->idle > 0 &&
        (state_->scheduler.has_runnable() ||
         (state_->timekeeper == kNever && next_look(state_->scheduler.next_deadline()) != kNever));
    if (hand_over) state_->queue->doorbell().ring();
    run(*turn, lock);
  }
}

Nanoseconds Executor::next_look(Nanoseconds due) const {
  constexpr Nanoseconds kBeat = 1'000'000'000;
  return state_->beat == nullptr ? due : std::min(due, steady_now() + kBeat);
}

void Executor::wait_for_work(std::uint32_t seen, std::unique_lock<std::mutex>& lock) {
  // One idle worker wakes for the timers, the others for notifications only.
  const Nanoseconds deadline = next_look(state_->scheduler.next_deadline());
  const bool keeps_time = deadline < state_->timekeeper;
  if (keeps_time) state_->timekeeper = deadline;
  ++state_->idle;
  lock.unlock();
  state_->queue->doorbell().wait(seen, keeps_time ? deadline : kNever);
  lock.lock();
  --state_->idle;
  if (keeps_time && state_->timekeeper == deadline) state_->timekeeper = kNever;
}

void Executor::run(RunningTurn& turn, std::unique_lock<std::mutex>& lock) {
  bool look_again = false;
  lock.unlock();
  // Whatever happens below, the node must count as quiet afterwards.
  struct End {
    Executor& executor;
    RunningTurn& turn;
    const bool& look_again;
    std::unique_lock<std::mutex>& lock;
    ~End() {
      turn.work = Work();
      turn.waitable.reset();
      const std::shared_ptr<NodeSlot> slot = turn.entry.slot;
      lock.lock();
      executor.state_->scheduler.finish(turn, look_again);
      if (slot->removed && slot->running == 0) executor.state_->quiet.ring_all();
    }
  } const end{*this, turn, look_again, lock};

  WakeToken& token = *turn.entry.token;
  turn.waitable = token.lock();
  if (!turn.waitable) return;
  const std::size_t events = token.events.exchange(0);
  turn.work = take_or_report(*turn.waitable, state_->takes);
  if (!turn.work) {
    // A sample that could not be delivered may hide others.
    look_again = events > 1;
    return;
  }
  look_again = true;
  if (token.group->kind() == CallbackGroup::Kind::reentrant && (events > 1 || token.timed)) {
    token.notify(events > 1 ? events - 1 : 0);  // another worker may go on meanwhile
  }
  const detail::RunningNode running(turn.waitable->logger());
  turn.work();
}

void Executor::abandon() {
  detail::forget(state_->mutex);  // a thread may have died with it
  std::list<RunningTurn> held;
  {
    const std::lock_guard lock(state_->mutex);
    held = state_->scheduler.abandon();
    state_->spinning = false;
    state_->idle = 0;
    state_->timekeeper = kNever;
  }
  state_->quiet.ring_all();
}

Executor::Spinning::Spinning(Executor& executor) : executor_(executor) {
  const std::lock_guard lock(executor_.state_->mutex);
  if (executor_.state_->spinning) throw std::logic_error("spin: the executor is spinning already");
  executor_.state_->spinning = true;
}

Executor::Spinning::~Spinning() {
  const std::lock_guard lock(executor_.state_->mutex);
  executor_.state_->spinning = false;
}

SingleThreadedExecutor::SingleThreadedExecutor()
    : SingleThreadedExecutor(std::make_shared<detail::StopFlag>()) {}

SingleThreadedExecutor::SingleThreadedExecutor(std::shared_ptr<detail::StopFlag> stop)
    : Executor(std::move(stop)) {}

void SingleThreadedExecutor::spin() {
  const Spinning spinning(*this);
  work();
}

MultiThreadedExecutor::MultiThreadedExecutor(std::size_t threads)
    : MultiThreadedExecutor(threads, std::make_shared<detail::StopFlag>()) {}

MultiThreadedExecutor::MultiThreadedExecutor(std::size_t threads,
                                             std::shared_ptr<detail::StopFlag> stop)
    : Executor(std::move(stop)),
      threads_(threads != 0 ? threads
                            : std::max<std::size_t>(2, std::thread::hardware_concurrency())) {}

void MultiThreadedExecutor::spin() {
  const Spinning spinning(*this);
  // Not a catch: an uncaught exception is to end the process where it is thrown.
  // Where a caller catches it, it ends here as in another thread; none could go on with some of
  // the threads.
  struct Ended {
    bool in_order = false;
    ~Ended() {
      if (!in_order) std::terminate();
    }
  } ended;
  workers_.reserve(threads_ - 1);
  while (workers_.size() < threads_ - 1) workers_.emplace_back([this] { work(); });
  work();
  for (std::thread& worker : workers_) worker.join();
  workers_.clear();
  ended.in_order = true;
}

void MultiThreadedExecutor::abandon() {
  for (std::thread& worker : workers_) detail::forget(worker);
  workers_.clear();
  Executor::abandon();
}

}  // namespace play_launch
