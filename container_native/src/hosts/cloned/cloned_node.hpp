#pragma once

#include <signal.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "hosts/cloned/lock_watch.hpp"
#include "hosts/cloned/node_program.hpp"
#include "hosts/isolated/isolated_node.hpp"
#include "isolation/clone/child.hpp"
#include "isolation/clone/donor_thread.hpp"
#include "isolation/record/crash_slot.hpp"

namespace play_launch::container {

/// A node in a process that shares the container's memory: its donor thread, its process, and the
/// process that cleans up should it die.
class ClonedNode final : public IsolatedNode {
 public:
  /// Starts the donor thread and with it the child, which dumps core or not when it crashes. Throws
  /// std::system_error.
  ClonedNode(std::uint64_t unique_id, const BackendList& backends, const ExecutorChoice& choice,
             LoadRequest request, int doorbell, LockWatch& lock_watch, bool core_dumps);

  void tell(NodeHostObserver& observer, IsolationTotals& totals) override;
  bool is_over() const override { return told_end_ && told_burial_; }
  std::optional<std::chrono::nanoseconds> silence() const override;

 private:
  bool is_dead() const override { return dead_; }
  const LoadRequest& request() const override { return program_.request(); }
  std::string full_name() const override;
  void ask_to_leave() override { program_.cancel(); }
  bool signal(int number) override { return isolation::send_signal(slot_, number); }
  void abandon() override { isolation::send_signal(burial_slot_, SIGKILL); }

  void donate() noexcept;
  void tell_refusal();
  void end_if_replaced();
  void donated() noexcept;
  void tell_progress(NodeHostObserver& observer, NodeStage stage);
  void tell_end(NodeHostObserver& observer, IsolationTotals& totals);
  NodeDeath death();
  void count_burial(IsolationTotals& totals) const;

  const std::string process_name_;
  LockWatch& lock_watch_;
  const bool core_dumps_;
  NodeProgram program_;
  NodeBurial burial_{program_};

  // Written on the donor.
  isolation::CrashSlot slot_;
  isolation::CrashSlot burial_slot_;
  isolation::ChildEnd end_;
  isolation::ChildEnd burial_end_;
  bool gave_back_ = false;           // the memory of its threads
  std::atomic<bool> dead_{false};    // end_ is valid
  std::atomic<bool> buried_{false};  // burial_end_ is valid, no process is left, and the donor ends

  // The monitor's.
  NodeStage told_ = NodeStage::preparing;
  bool told_end_ = false;
  bool told_refusal_ = false;
  bool replaced_ = false;
  std::chrono::steady_clock::time_point constructing_since_;
  std::optional<std::vector<std::string>> backtrace_;
  bool told_burial_ = false;

  isolation::DonorThread donor_;  // last: it uses all of the above
};

}  // namespace play_launch::container
