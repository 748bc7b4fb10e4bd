#pragma once

#include <memory>
#include <string>
#include <vector>

#include "hosts/isolated/isolated_host.hpp"

namespace play_launch::container {

/// With processes that have memory of their own: the mechanism process. Each is this program once
/// more, as a container of one node; messages between nodes go through the middleware.
class ProcessHost final : public IsolatedHost {
 public:
  /// `executor` is that of each node; `core_dumps`: nodes that crash dump core; `ros_arguments` are
  /// what stands behind --ros-args.
  ProcessHost(BackendList backends, const ExecutorChoice& executor, bool core_dumps,
              const std::vector<std::string>& ros_arguments);

 private:
  std::shared_ptr<IsolatedNode> start(std::uint64_t unique_id, LoadRequest request,
                                      NodeResources resources, int doorbell) override;

  std::vector<std::string> arguments_;
  std::vector<std::string> ros_arguments_;
};

}  // namespace play_launch::container
