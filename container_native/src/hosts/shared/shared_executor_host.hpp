#pragma once

#include <cstdint>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "components/backend_list.hpp"
#include "hosts/node_host.hpp"

namespace play_launch::container {

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

  /// Runs `task` in a thread of that name. Throws std::system_error when there is none to be had.
  void run(const std::string& name, std::function<void()> task);
  void construct(std::uint64_t unique_id, const LoadRequest& request);
  void destroy(std::uint64_t unique_id);

  const ProcessIdentity process_;
  NodeHostObserver* observer_ = nullptr;
  const BackendList backends_;
  std::vector<Spinner> spinners_;  // of the backend with the same index
  std::mutex mutex_;               // guards what follows
  std::map<std::uint64_t, Node> nodes_;
  std::mutex tasks_mutex_;
  std::vector<std::future<void>> tasks_;  // last: their threads use all of the above
};

}  // namespace play_launch::container
