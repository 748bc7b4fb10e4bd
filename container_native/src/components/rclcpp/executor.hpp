#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <memory>
#include <mutex>
#include <optional>
#include <play_launch/detail/stop_flag.hpp>
#include <rclcpp/executor.hpp>
#include <string>
#include <thread>
#include <vector>

#include "components/component_backend.hpp"

namespace play_launch::rclcpp_backend {

/// rclcpp's executor, with what its own ones lack for nodes that are unloaded while it spins, or
/// die in a callback: remove() waits for running callbacks, it may be stopped by a signal handler
/// and before spin(), and what a callback holds is kept here instead of on the stack of its thread,
/// so that it can be released when that thread has exited.
///
/// With one thread callbacks run in the one that calls spin(), else in that one and others, by the
/// rules of callback groups.
class NodeExecutor final : public rclcpp::Executor, public container::ComponentExecutor {
 public:
  using Node = rclcpp::node_interfaces::NodeBaseInterface;

  /// `stop` is the request to stop; rclcpp cannot be woken from a signal handler, so a
  /// thread of the executor waits for the request.
  NodeExecutor(std::size_t threads, std::shared_ptr<detail::StopFlag> stop);
  ~NodeExecutor() override;

  /// What a callback throws ends the process.
  void spin() override;
  /// Makes this or the next spin() return, once and for all.
  void cancel() override;

  /// Of components that are RclcppComponent. Throws what add_node() throws.
  void add(container::Component& component) override;
  /// Not for a callback.
  void remove(container::Component& component) override;
  void beat_into(container::Beat& beat) override;

  /// Full name of the node that has the group, of those that were put in; empty: none has.
  std::string name_of(const rclcpp::CallbackGroup::SharedPtr& group) const;

  void abandon() override;

 private:
  struct Worker {
    std::optional<rclcpp::AnyExecutable> work;
    const rclcpp::CallbackGroup* group = nullptr;  // whose callback runs; guarded by runs_mutex_
    std::thread thread;                            // none for the one that calls spin()
  };

  void run(Worker& worker);
  bool take(Worker& worker);
  void execute(rclcpp::AnyExecutable& work);
  void finish(Worker& worker);
  bool may_run() const;
  std::chrono::nanoseconds note_beat();
  bool runs_any_of(const std::vector<const rclcpp::CallbackGroup*>& groups) const;

  const std::shared_ptr<detail::StopFlag> stop_;
  bool abandoned_ = false;
  container::Beat* beat_ = nullptr;
  std::vector<Worker> workers_;

  /// Held by the one worker that waits for work.
  std::mutex take_mutex_;
  std::atomic<std::size_t> removals_{0};  // that want the mutex
  std::condition_variable removed_;

  std::mutex runs_mutex_;
  std::condition_variable run_finished_;

  mutable std::mutex nodes_mutex_;
  std::vector<Node::SharedPtr> nodes_;

  std::thread interrupter_;  // last: it uses the above
};

}  // namespace play_launch::rclcpp_backend
