#pragma once

#include <memory>
#include <string>
#include <vector>

#include "container/isolated_host.hpp"
#include "container/options.hpp"

namespace play_launch::container {

/// With processes that have memory of their own: the mechanism process. Each is this program once
/// more, as a container of one node; messages between nodes go through the middleware.
class ProcessHost final : public IsolatedHost {
 public:
  /// `threads` is for the executor of each node.
  ProcessHost(std::vector<std::unique_ptr<ComponentBackend>> backends, const Options& options,
              std::size_t threads);

 private:
  std::shared_ptr<IsolatedNode> start(std::uint64_t unique_id, LoadRequest request,
                                      int doorbell) override;

  std::vector<std::string> arguments_;
};

}  // namespace play_launch::container
