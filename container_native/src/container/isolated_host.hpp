#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "container/backend_list.hpp"
#include "container/isolated_node.hpp"
#include "container/node_host.hpp"
#include "control/unique_fd.hpp"

namespace play_launch::container {

/// Every node lives in a process of its own, which shares the memory of the container: the modes
/// isolated and isolated_mt with the mechanism shared_memory. The node is constructed, runs and is
/// destroyed there, with an executor of its own; its death is an event.
///
/// The container must have its own node in the context before the first load, so that the threads
/// of the participant are the container's.
class CloneIsolatedHost final : public NodeHost {
 public:
  /// `choice` is for the executor of each node.
  CloneIsolatedHost(std::vector<std::unique_ptr<ComponentBackend>> backends,
                    const ExecutorChoice& choice);
  /// All nodes must have ended; waits for what is left of their processes.
  ~CloneIsolatedHost() override;

  void set_observer(NodeHostObserver& observer) override { observer_ = &observer; }
  std::optional<std::string> expected_full_name(const LoadRequest& request) const override {
    return backends_.expected_full_name(request);
  }
  void load(std::uint64_t unique_id, LoadRequest request) override;
  void unload(std::uint64_t unique_id) override;
  void stop_spinning() override;
  void hurry(std::chrono::steady_clock::time_point deadline) override;
  HostTotals totals() const override;

 private:
  using Time = IsolatedNode::Time;

  void monitor();
  Time look_after_all();
  void wait_until(Time deadline);

  const BackendList backends_;
  const ExecutorChoice choice_;
  const control::UniqueFd doorbell_;
  NodeHostObserver* observer_ = nullptr;
  IsolationTotals totals_;

  std::mutex mutex_;  // guards what follows; never taken by a child
  std::map<std::uint64_t, std::shared_ptr<IsolatedNode>> nodes_;
  Time end_ = Time::max();
  bool done_ = false;

  std::thread monitor_;  // last: it uses all of the above
};

}  // namespace play_launch::container
