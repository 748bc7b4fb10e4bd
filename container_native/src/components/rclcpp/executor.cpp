#include "components/rclcpp/executor.hpp"

#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <play_launch/detail/forget.hpp>
#include <play_launch/detail/running_node.hpp>
#include <rclcpp/executor_options.hpp>
#include <rclcpp/utilities.hpp>
#include <utility>

#include "components/rclcpp/component.hpp"
#include "components/rclcpp/runtime.hpp"

namespace play_launch::rclcpp_backend {
namespace {

/// For a function that takes a share in what its caller holds anyway. A thread that dies in there
/// would never give it back.
template <class T>
std::shared_ptr<T> unshared(const std::shared_ptr<T>& owner) {
  return {std::shared_ptr<void>(), owner.get()};
}

/// rclcpp does not note whose callback it is. All nodes are looked through for that, so only when
/// requested.
class RunningCallback final : public detail::RunningNode {
 public:
  RunningCallback(const NodeExecutor& executor, const rclcpp::CallbackGroup::SharedPtr& group)
      : executor_(executor), group_(group) {}

 private:
  std::string name() const override { return executor_.name_of(group_); }

  const NodeExecutor& executor_;
  const rclcpp::CallbackGroup::SharedPtr& group_;
};

}  // namespace

NodeExecutor::NodeExecutor(std::size_t threads, std::shared_ptr<detail::StopFlag> stop)
    : rclcpp::Executor(rclcpp::ExecutorOptions()),
      stop_(std::move(stop)),
      workers_(std::max<std::size_t>(threads, 1)),
      interrupter_([this] {
        ::pthread_setname_np(::pthread_self(), "interrupt");
        stop_->wait();
        interrupt_guard_condition_->trigger();
      }) {
  // What is added before spin() is then collected by spin(), and not meanwhile by the thread that
  // adds it.
  spinning = true;
}

NodeExecutor::~NodeExecutor() {
  if (interrupter_.joinable()) {
    stop_->set();
    interrupter_.join();
  }
}

void NodeExecutor::spin() {
  for (std::size_t i = 1; i < workers_.size(); ++i) {
    Worker& worker = workers_[i];
    worker.thread = std::thread([this, &worker] { run(worker); });
  }
  run(workers_.front());
  for (std::size_t i = 1; i < workers_.size(); ++i) {
    workers_[i].thread.join();
  }
  spinning = false;
  wait_result_.reset();
}

void NodeExecutor::cancel() { stop_->set(); }

void NodeExecutor::beat_into(container::Beat& beat) {
  beat_ = &beat;
  note_beat();
}

/// Notes that a thread looks for work; how long it may then wait for it.
std::chrono::nanoseconds NodeExecutor::note_beat() {
  if (beat_ == nullptr) {
    return std::chrono::nanoseconds(-1);  // without limit
  }
  const std::chrono::nanoseconds now = std::chrono::steady_clock::now().time_since_epoch();
  beat_->last.store(now.count(), std::memory_order_relaxed);
  return std::chrono::seconds(1);
}

bool NodeExecutor::may_run() const { return !stop_->is_set() && rclcpp::ok(context_); }

void NodeExecutor::run(Worker& worker) {
  while (may_run()) {
    if (take(worker)) {
      execute(*worker.work);
    }
    finish(worker);
  }
}

bool NodeExecutor::take(Worker& worker) {
  std::unique_lock lock(take_mutex_);
  removed_.wait(lock, [this] { return removals_ == 0; });
  worker.work.emplace();
  if (!may_run()) {
    interrupt_guard_condition_->trigger();  // the others that sit here are to leave, too
    return false;
  }
  if (!get_next_executable(*worker.work, note_beat())) {
    return false;
  }
  const std::lock_guard runs(runs_mutex_);
  worker.group = worker.work->callback_group.get();
  return true;
}

// An exception of another type finds no handler up to the end of the stack, nor a function that is
// noexcept: std::terminate() is called where it was thrown, before any frame is left.
void NodeExecutor::execute(rclcpp::AnyExecutable& work) try {
  const RunningCallback running(*this, work.callback_group);
  if (work.timer) {
    execute_timer(unshared(work.timer), work.data);
  }
  if (work.subscription) {
    execute_subscription(unshared(work.subscription));
  }
  if (work.service) {
    execute_service(unshared(work.service));
  }
  if (work.client) {
    execute_client(unshared(work.client));
  }
  if (work.waitable) {
    work.waitable->execute(std::as_const(work.data));
  }
} catch (const ContextIsShared&) {
  // The callback has ended its node, and stop_ is set.
}

void NodeExecutor::finish(Worker& worker) {
  const rclcpp::CallbackGroup::SharedPtr group = worker.work->callback_group;
  worker.work.reset();  // which frees the group for the next callback
  {
    const std::lock_guard runs(runs_mutex_);
    worker.group = nullptr;
  }
  run_finished_.notify_all();
  if (workers_.size() > 1 && group != nullptr &&
      group->type() == rclcpp::CallbackGroupType::MutuallyExclusive) {
    // What is ready in this group was passed over by the others.
    interrupt_guard_condition_->trigger();
  }
}

void NodeExecutor::add(container::Component& component) {
  const Node::SharedPtr& node = RclcppComponent::node_of(component);
  const std::lock_guard lock(nodes_mutex_);  // a first callback may ask for the name
  nodes_.push_back(node);
  try {
    add_node(node);
  } catch (...) {
    nodes_.pop_back();
    throw;
  }
}

std::string NodeExecutor::name_of(const rclcpp::CallbackGroup::SharedPtr& group) const {
  const std::lock_guard lock(nodes_mutex_);
  const auto found = std::ranges::find_if(
      nodes_, [&group](const auto& node) { return node->callback_group_in_node(group); });
  return found != nodes_.end() ? (*found)->get_fully_qualified_name() : "";
}

void NodeExecutor::remove(container::Component& component) {
  const Node::SharedPtr& node = RclcppComponent::node_of(component);
  std::vector<const rclcpp::CallbackGroup*> groups;
  {
    ++removals_;
    if (!abandoned_) {
      interrupt_guard_condition_->trigger();
    }
    const std::lock_guard lock(take_mutex_);
    // A thread that died waiting cannot be woken: the C library would wait for it to wake up.
    remove_node(node, !abandoned_);
    // What was found ready may be this node's; the rest is found ready again.
    wait_result_.reset();
    --removals_;
  }
  removed_.notify_all();
  node->for_each_callback_group(
      [&groups](const rclcpp::CallbackGroup::SharedPtr& group) { groups.push_back(group.get()); });
  std::unique_lock runs(runs_mutex_);
  run_finished_.wait(runs, [&] { return !runs_any_of(groups); });
  const std::lock_guard lock(nodes_mutex_);
  std::erase(nodes_, node);
}

bool NodeExecutor::runs_any_of(const std::vector<const rclcpp::CallbackGroup*>& groups) const {
  return std::ranges::any_of(workers_, [&groups](const Worker& worker) {
    return worker.group != nullptr && std::ranges::find(groups, worker.group) != groups.end();
  });
}

void NodeExecutor::abandon() {
  abandoned_ = true;
  detail::forget(interrupter_);
  for (Worker& worker : workers_) {
    detail::forget(worker.thread);
    worker.group = nullptr;
    worker.work.reset();
  }
  detail::forget(mutex_);  // rclcpp's own
  detail::forget(take_mutex_);
  detail::forget(runs_mutex_);
  detail::forget(nodes_mutex_);
  detail::forget(removed_);
  detail::forget(run_finished_);
  removals_ = 0;
  spinning = false;
  wait_result_.reset();
}

}  // namespace play_launch::rclcpp_backend
