#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "hosts/cloned/lock_watch.hpp"
#include "hosts/cloned/memory_domains.hpp"
#include "hosts/isolated/isolated_host.hpp"

namespace play_launch::container {

/// With processes that share the memory of the container: the mechanism shared_memory. A node is
/// constructed, runs and is destroyed in its process, with an executor of its own, and messages
/// reach it by pointer.
///
/// The container must have its own node in the context before the first load, so that the threads
/// of the participant are the container's.
class CloneIsolatedHost final : public IsolatedHost {
 public:
  /// `choice` is for the executor of each node; `core_dumps`: nodes that crash dump core. Without
  /// `domains` private memory is ordinary memory.
  CloneIsolatedHost(BackendList backends, const ExecutorChoice& choice, bool core_dumps,
                    std::shared_ptr<MemoryDomains> domains);

  std::vector<std::string> dead_locks() const override { return lock_watch_.dead_locks(); }

 private:
  std::shared_ptr<IsolatedNode> start(std::uint64_t unique_id, LoadRequest request,
                                      NodeResources resources, int doorbell) override;

  const ExecutorChoice choice_;
  const bool core_dumps_;
  const std::shared_ptr<MemoryDomains> domains_;
  LockWatch lock_watch_;
};

}  // namespace play_launch::container
