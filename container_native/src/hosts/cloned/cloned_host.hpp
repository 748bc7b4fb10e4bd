#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "hosts/cloned/lock_watch.hpp"
#include "hosts/cloned/memory_domains.hpp"
#include "hosts/cloned/node_program.hpp"
#include "hosts/isolated/isolated_host.hpp"
#include "hosts/isolated/isolated_node.hpp"

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
                                      NodeResources resources, int event_fd) override;

  const ExecutorChoice choice_;
  const bool core_dumps_;
  const std::shared_ptr<MemoryDomains> domains_;
  LockWatch lock_watch_;
};

/// A node in a process that shares the container's memory, as the monitor sees it.
class ClonedNode final : public IsolatedNode {
 public:
  /// Starts the donor thread and with it the child, which dumps core or not when it crashes.
  /// `domain` is null where its private memory is ordinary memory. Throws std::system_error.
  ClonedNode(std::uint64_t unique_id, const BackendList& backends, const ExecutorChoice& choice,
             LoadRequest request, NodeResources resources, const WatchUrgency& watch_urgency,
             int event_fd, LockWatch& lock_watch, bool core_dumps,
             std::unique_ptr<MemoryDomain> domain, const MemoryDomains* domains);

  std::optional<std::chrono::nanoseconds> silence() const override;
  void rise(Urgency urgency) noexcept override { donor_.rise(urgency); }

 private:
  NodeLife look() override;
  const LoadRequest& request() const override { return program_.request(); }
  ProcessIdentity process() const override;
  std::string full_name() const override;
  std::string failure() const override { return program_.failure(); }
  std::string why_it_left() const override;
  NodeDeath death() override;
  bool is_cleaned_up() override;
  void on_death_reported() override { donor_.begin_cleanup(); }
  void ask_to_leave() override { program_.cancel(); }
  bool signal(int number) override { return donor_.signal(number); }
  void abandon() override { donor_.end_cleanup(); }

  void symbolise();
  void name_owner();
  void end_if_replaced();

  bool replaced_ = false;
  std::optional<std::chrono::steady_clock::time_point> constructing_since_;
  std::optional<std::vector<std::string>> backtrace_;

  const MemoryDomains* const domains_;  // null: there are none
  const std::unique_ptr<MemoryDomain> domain_;
  bool is_domain_named_ = false;
  NodeProgram program_;
  NodeDonor donor_;  // last: its thread uses the program
};

}  // namespace play_launch::container
