#pragma once

#include <signal.h>

#include <atomic>
#include <cstdint>
#include <string>

#include "base/unique_fd.hpp"
#include "hosts/cloned/lock_watch.hpp"
#include "hosts/cloned/memory_domains.hpp"
#include "hosts/cloned/node_program.hpp"
#include "hosts/isolated/node_resources.hpp"
#include "isolation/clone/child.hpp"
#include "isolation/clone/donor_thread.hpp"
#include "isolation/record/crash_slot.hpp"

namespace play_launch::container {

/// What a node's donor thread does: it becomes the node's process, reaps it, and becomes the
/// process that cleans up should the node have died. And what these write for the monitor:
/// everything here is written by the donor or a child, and valid from the part of the NodeLife on
/// that is named.
class NodeDonor {
 public:
  /// Starts the thread and with it the child, which dumps core or not when it crashes. Throws
  /// std::system_error. `process_name` is what `ps` shows. `domain` may be null.
  NodeDonor(std::uint64_t unique_id, NodeProgram& program, std::string process_name,
            LockWatch& lock_watch, bool core_dumps, NodeResources resources,
            const WatchUrgency& watch_urgency, const MemoryDomain* domain);

  /// The node's process. Any time: the slot says itself what of it is valid.
  isolation::CrashSlot& slot() { return slot_; }
  const isolation::CrashSlot& slot() const { return slot_; }
  bool signal(int number) { return isolation::send_signal(slot_, number); }
  void rise(Urgency urgency) noexcept { thread_.rise(urgency); }
  /// The death is reported. Until then, for a short time, the donor leaves the processor to those
  /// that report it: users wait for the report, not for the cleanup.
  void begin_burial() noexcept;
  void end_burial() { isolation::send_signal(burial_slot_, SIGKILL); }

  /// How the node's process ended; NodeLife::ended or died.
  const isolation::ChildEnd& end() const { return end_; }
  /// What stays behind, and why; empty: nothing. NodeLife::buried, after died.
  std::string remains() const;

 private:
  void donate() noexcept;
  void wait_for_report() const noexcept;
  void enter_domain(isolation::ChildOptions& options) const noexcept;
  void bury();
  void donated() noexcept { program_.reach(NodeLife::buried); }

  const std::uint64_t unique_id_;
  NodeProgram& program_;
  NodeBurial burial_{program_};
  const std::string process_name_;
  LockWatch& lock_watch_;
  const bool core_dumps_;
  const NodeResources resources_;
  UniqueFd group_{resources_.open_group()};
  const WatchUrgency& watch_urgency_;
  const MemoryDomain* const domain_;

  isolation::CrashSlot slot_;
  isolation::CrashSlot burial_slot_;
  isolation::ChildEnd end_;
  isolation::ChildEnd burial_end_;
  std::atomic<std::uint32_t> reported_{0};  // a futex
  bool gave_back_ = false;                  // the memory of its threads

  isolation::DonorThread thread_;  // last: it uses all of the above
};

}  // namespace play_launch::container
