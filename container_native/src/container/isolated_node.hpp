#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include "container/node_host.hpp"
#include "container/node_program.hpp"
#include "isolation/crash_slot.hpp"
#include "isolation/donor_thread.hpp"

namespace play_launch::container {

/// HostTotals while they grow.
struct IsolationTotals {
  std::atomic<std::uint32_t> crashes{0};
  std::atomic<std::uint32_t> undertaken{0};
  std::atomic<std::uint32_t> leaked{0};
  std::atomic<std::uint32_t> unquiesced{0};
};

/// One node in a process that shares the container's memory: its thread, its process, and what
/// remains to be done about it. All but the constructor and leave() is for one thread, the
/// monitor's.
class IsolatedNode {
 public:
  using Time = std::chrono::steady_clock::time_point;

  /// Starts the donor thread and with it the child. Throws std::system_error.
  IsolatedNode(std::uint64_t unique_id, const BackendList& backends, const ExecutorChoice& choice,
               LoadRequest request, int doorbell);
  IsolatedNode(const IsolatedNode&) = delete;
  IsolatedNode& operator=(const IsolatedNode&) = delete;
  ~IsolatedNode() = default;

  /// Asks the node to leave. Any thread; rings the doorbell.
  void leave() noexcept;

  /// Tells the observer what has happened since the last call. Counts deaths in `totals`.
  void tell(NodeHostObserver& observer, IsolationTotals& totals);

  /// Does what is due for a node that should leave, and returns when to come again (max: not by
  /// itself). `end`: when it must be gone (max: whenever).
  Time press(Time now, Time end);

  /// Whether the node's processes are gone for good, and everything is told.
  bool is_over() const { return told_end_ && finished_.load(); }

 private:
  enum class Pressure { none, cancelled, terminated, killed };

  void donate() noexcept;
  void tell_end(NodeHostObserver& observer, IsolationTotals& totals);
  NodeDeath death() const;
  void count_burial(IsolationTotals& totals);
  std::string label() const;
  void signal(int number) const;

  const std::uint64_t unique_id_;
  const int doorbell_;
  const std::string process_name_;
  NodeProgram program_;
  NodeBurial burial_{program_};

  // Written on the donor.
  isolation::CrashSlot slot_;
  isolation::CrashSlot burial_slot_;
  isolation::ChildEnd end_;
  isolation::ChildEnd burial_end_;
  std::atomic<bool> dead_{false};      // end_ is valid
  std::atomic<bool> finished_{false};  // burial_end_ is valid, and no process is left

  std::atomic<bool> leaving_{false};

  // The monitor's.
  NodeStage told_ = NodeStage::preparing;
  bool told_end_ = false;
  bool told_burial_ = false;
  Pressure pressure_ = Pressure::none;
  Time leaving_since_ = Time::max();

  isolation::DonorThread donor_;  // last: it uses all of the above
};

}  // namespace play_launch::container
