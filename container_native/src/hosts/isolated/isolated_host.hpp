#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "base/scheduling.hpp"
#include "base/unique_fd.hpp"
#include "components/backend_list.hpp"
#include "hosts/isolated/isolated_node.hpp"
#include "hosts/node_host.hpp"

namespace play_launch::container {

/// Every node lives in a process of its own: the modes isolated and isolated_mt. A thread, the
/// monitor, follows what the nodes' processes do, reports it, and ends those that should
/// leave and do not. What kind of process it is, subclasses know.
class IsolatedHost : public NodeHost {
 public:
  void set_observer(NodeHostObserver& observer) override { observer_ = &observer; }
  void load(std::uint64_t unique_id, LoadRequest request) override;
  void unload(std::uint64_t unique_id) override;
  void give_up(std::uint64_t unique_id) override { unload(unique_id); }
  void stop_spinning() override;
  void end_by(std::chrono::steady_clock::time_point deadline) override;
  std::optional<std::chrono::nanoseconds> silence(std::uint64_t unique_id) const override;
  std::string wait_of(std::uint64_t unique_id) const override {
    return backends_.wait_of(unique_id);
  }

 protected:
  explicit IsolatedHost(BackendList backends);
  /// What hangs in the middleware, a line for each node.
  std::vector<std::string> hangs() const;
  /// All nodes must have ended; waits for what is left of their processes.
  ~IsolatedHost() override;

  /// Starts the process. Throws std::exception if it cannot be started.
  virtual std::shared_ptr<IsolatedNode> start(std::uint64_t unique_id, LoadRequest request,
                                              NodeResources resources, int event_fd) = 0;
  const BackendList& backends() const { return backends_; }
  const WatchUrgency& watch_urgency() const { return watch_urgency_; }

 private:
  using Time = IsolatedNode::Time;
  using Nodes = std::vector<std::pair<std::uint64_t, std::shared_ptr<IsolatedNode>>>;

  void monitor();
  Time look_after(Nodes& nodes, Time end);
  void wait_until(Time deadline, const Nodes& nodes) const;
  void rise_above(Urgency node);

  const BackendList backends_;
  const UniqueFd event_fd_;
  const Urgency urgency_ = own_urgency();  // of the container's other threads
  WatchUrgency watch_urgency_{urgency_};
  NodeHostObserver* observer_ = nullptr;

  mutable std::mutex mutex_;  // guards what follows; no process but the container takes it
  std::map<std::uint64_t, std::shared_ptr<IsolatedNode>> nodes_;
  Time end_ = Time::max();
  bool done_ = false;
  pid_t monitor_number_ = 0;  // 0: it has not begun

  std::thread monitor_;  // last: it uses all of the above
};

}  // namespace play_launch::container
