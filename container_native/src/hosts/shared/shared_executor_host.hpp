#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "components/backend_list.hpp"
#include "hosts/node_host.hpp"

namespace play_launch::container {

/// Short-lived threads that are joined together at the end.
///
/// A finished thread is joined by the next one that finishes, so that at most one of them is left
/// over however many have run.
class TaskGroup {
 public:
  TaskGroup() = default;
  TaskGroup(const TaskGroup&) = delete;
  TaskGroup& operator=(const TaskGroup&) = delete;
  /// Waits for all tasks.
  ~TaskGroup();

  /// Runs `task` in a thread of its own, named `name` (at most 15 characters).
  /// Throws std::system_error when there is no thread to be had; then `task` does not run.
  void run(const std::string& name, std::function<void()> task);

 private:
  void finish(std::uint64_t number);

  std::mutex mutex_;
  std::map<std::uint64_t, std::thread> running_;
  std::thread finished_;
  std::uint64_t last_number_ = 0;
};

/// All nodes live in this process and share one executor (one for each backend that is in use):
/// the modes standard and mt. Each constructor, and each unloading, runs in a thread of its own.
class SharedExecutorHost final : public NodeHost {
 public:
  SharedExecutorHost(BackendList backends, const ExecutorChoice& choice);
  /// All nodes must be gone.
  ~SharedExecutorHost() override;

  void set_observer(NodeHostObserver& observer) override { observer_ = &observer; }
  void load(std::uint64_t unique_id, LoadRequest request) override;
  void unload(std::uint64_t unique_id) override;
  void stop_spinning() override;
  std::string wait_of(std::uint64_t unique_id) const override {
    return backends_.wait_of(unique_id);
  }

 private:
  struct Spinner {
    std::shared_ptr<detail::StopFlag> stop;
    std::unique_ptr<ComponentExecutor> executor;
    std::thread thread;
  };
  struct Node {
    std::unique_ptr<Component> component;
    ComponentExecutor* executor = nullptr;
  };

  void construct(std::uint64_t unique_id, const LoadRequest& request);
  void destroy(std::uint64_t unique_id);

  const ProcessIdentity process_;
  NodeHostObserver* observer_ = nullptr;
  const BackendList backends_;
  std::vector<Spinner> spinners_;  // of the backend with the same index
  std::mutex mutex_;
  std::map<std::uint64_t, Node> nodes_;
  TaskGroup tasks_;  // last: its threads use all of the above
};

}  // namespace play_launch::container
