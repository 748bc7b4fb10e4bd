#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/unique_fd.hpp"
#include "hosts/cloned/lock_watch.hpp"
#include "hosts/cloned/memory_domains.hpp"
#include "hosts/cloned/node_program.hpp"
#include "hosts/isolated/isolated_host.hpp"
#include "hosts/isolated/isolated_node.hpp"
#include "isolation/clone/child.hpp"
#include "isolation/clone/donor_thread.hpp"

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

  std::vector<std::string> dead_locks() const override;

 private:
  friend class ClonedNode;

  std::shared_ptr<IsolatedNode> start(std::uint64_t unique_id, LoadRequest request,
                                      NodeResources resources, int event_fd) override;

  const ExecutorChoice choice_;
  const bool core_dumps_;
  const std::shared_ptr<MemoryDomains> domains_;
  LockWatch lock_watch_;
};

/// A node in a process that shares the container's memory, as the monitor sees it; and what its
/// donor thread does, which becomes the node's process, reaps it, and becomes the process that
/// cleans up should the node have died.
class ClonedNode final : public IsolatedNode {
 public:
  /// Starts the donor thread and with it the child. `domain` is null where its private memory is
  /// ordinary memory. Throws std::system_error.
  ClonedNode(std::uint64_t unique_id, CloneIsolatedHost& host, LoadRequest request,
             NodeResources resources, int event_fd, std::unique_ptr<MemoryDomain> domain);

  std::optional<std::chrono::nanoseconds> silence() const override;
  std::string hang() override;
  void rise(Urgency urgency) noexcept override { donor_.rise(urgency); }

 private:
  NodeLife look() override;
  const LoadRequest& request() const override { return program_.request(); }
  ProcessIdentity process() const override { return {slot_.pid, slot_.start_time}; }
  std::string full_name() const override;
  std::string failure() const override { return program_.failure(); }
  std::string why_it_left() const override;
  NodeDeath death() override;
  bool is_cleaned_up() override;
  void on_death_reported() override;
  void ask_to_leave() override { program_.cancel(); }
  bool signal(int number) override { return isolation::send_signal(slot_, number); }
  void abandon() override { isolation::send_signal(cleanup_slot_, SIGKILL); }

  void symbolise();
  void name_owner();
  void end_if_replaced();

  // On the donor.
  void live() noexcept;
  void wait_for_report() const noexcept;
  void enter_domain(isolation::ChildOptions& options) const noexcept;
  void clean_up() noexcept;

  CloneIsolatedHost& host_;
  bool replaced_ = false;
  std::int64_t suspected_take_ = 0;
  std::chrono::steady_clock::time_point suspected_since_;
  std::optional<std::chrono::steady_clock::time_point> constructing_since_;
  std::optional<std::vector<std::string>> backtrace_;

  const std::unique_ptr<MemoryDomain> domain_;
  bool is_domain_named_ = false;
  const NodeResources resources_;
  UniqueFd group_{resources_.open_group()};

  // Written by the donor or a child, and valid from the part of the NodeLife on that is named.
  NodeProgram program_;
  const std::string process_name_;  // what `ps` shows
  NodeCleanup cleanup_{program_};
  isolation::CrashSlot slot_;  // of the node's process; says itself what of it is valid
  isolation::ChildEnd end_;    // of that; ended or died
  isolation::CrashSlot cleanup_slot_;
  isolation::ChildEnd cleanup_end_;         // finished, after died
  bool gave_back_ = false;                  // the memory of its threads; likewise
  std::atomic<std::uint32_t> reported_{0};  // a futex: the death is reported

  isolation::DonorThread donor_;  // last: it uses all of the above
};

}  // namespace play_launch::container
