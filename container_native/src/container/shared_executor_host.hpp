#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "container/component_backend.hpp"
#include "container/node_host.hpp"
#include "container/task_group.hpp"

namespace play_launch::container {

/// All nodes live in this process and share one executor (one for each backend that is in use):
/// the modes standard and mt. Each constructor, and each unloading, runs in a thread of its own.
class SharedExecutorHost final : public NodeHost {
 public:
  SharedExecutorHost(std::vector<std::unique_ptr<ComponentBackend>> backends,
                     const ExecutorChoice& choice);
  /// All nodes must be gone.
  ~SharedExecutorHost() override;

  void set_observer(NodeHostObserver& observer) override { observer_ = &observer; }
  std::optional<std::string> expected_full_name(const LoadRequest& request) const override;
  void load(std::uint64_t unique_id, LoadRequest request) override;
  void unload(std::uint64_t unique_id) override;
  void stop_spinning() override;

 private:
  struct Backend {
    std::unique_ptr<ComponentBackend> backend;
    std::unique_ptr<ComponentExecutor> executor;
    std::thread spinner;
  };
  struct Node {
    std::unique_ptr<Component> component;
    ComponentExecutor* executor = nullptr;
  };

  void construct(std::uint64_t unique_id, const LoadRequest& request);
  void destroy(std::uint64_t unique_id);
  Backend& backend_for(const std::string& package);

  const ProcessIdentity process_;
  NodeHostObserver* observer_ = nullptr;
  std::vector<Backend> backends_;
  std::mutex mutex_;
  std::map<std::uint64_t, Node> nodes_;
  TaskGroup tasks_;  // last: its threads use all of the above
};

}  // namespace play_launch::container
