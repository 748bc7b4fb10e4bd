#pragma once

#include <chrono>
#include <cstdint>
#include <ctime>
#include <optional>
#include <string>
#include <vector>

#include "base/process.hpp"
#include "components/component_options.hpp"

namespace play_launch::container {

/// How a process that held one node ended without being asked to.
struct NodeDeath {
  int exit_code = 0;
  int signal = 0;
  std::string reason;
  std::vector<std::string> backtrace;
  /// The libraries of the backtrace, see isolation::modules_of().
  std::vector<std::string> modules;
  /// When it happened; nothing: the moment at which it is reported.
  std::optional<std::chrono::steady_clock::time_point> when;
  /// Some of its threads may have died inside the middleware or the allocator.
  bool unquiesced = false;
};

/// Receives the ends of nodes. Every node ends with exactly one of on_load_failed, on_gone and
/// on_died. Calls come from any thread, for one node never two at a time.
class NodeHostObserver {
 public:
  virtual ~NodeHostObserver() = default;

  /// The constructor is about to run in `process`. `cpu_clock` counts the CPU time of the thread
  /// that runs it, and is valid until the next call for this node has returned.
  virtual void on_constructing(std::uint64_t unique_id, const ProcessIdentity& process,
                               clockid_t cpu_clock) = 0;
  /// The node's callbacks run. False: it was cancelled meanwhile; the host makes it leave as if
  /// unload() had been called.
  virtual bool on_loaded(std::uint64_t unique_id, const std::string& full_name) = 0;
  virtual void on_load_failed(std::uint64_t unique_id, const std::string& reason) = 0;
  /// The node is destroyed. `why` when it ended unrequested; empty: it was requested.
  virtual void on_gone(std::uint64_t unique_id, const std::string& why) = 0;
  /// The process of the node died, before on_loaded or after it, also while it was being unloaded.
  virtual void on_died(std::uint64_t unique_id, const NodeDeath& death) = 0;
  /// After on_died: what could be cleaned up is. `complete`: that is all.
  virtual void on_cleaned_up(std::uint64_t unique_id, bool complete) = 0;
};

/// Where nodes live: makes them, lets their callbacks run, and destroys them. No member blocks for
/// what user code does; outcomes go to the observer, never from within a call of the caller.
class NodeHost {
 public:
  NodeHost() = default;
  NodeHost(const NodeHost&) = delete;
  NodeHost& operator=(const NodeHost&) = delete;
  virtual ~NodeHost() = default;

  /// Before the first load; the observer must outlive the host's last node.
  virtual void set_observer(NodeHostObserver& observer) = 0;

  /// Begins to load. Throws std::exception when not even that works; then no call follows.
  virtual void load(std::uint64_t unique_id, LoadRequest request) = 0;

  /// Begins to unload a node that on_loaded took in. Throws std::exception when not even that
  /// works; then the node is what it was.
  virtual void unload(std::uint64_t unique_id) = 0;

  /// A node that on_loaded did not take in yet is not wanted any more. A host that can end its
  /// constructor does so within the limits of unload(); with the others it leaves when that
  /// returns.
  virtual void give_up(std::uint64_t) {}

  /// No callback starts any more, in any node. For the end of the container.
  virtual void stop_spinning() = 0;

  /// All nodes are to be gone by then: a host that can end nodes which do not end by themselves
  /// does so before. For the end of the container; an earlier deadline replaces a later one.
  virtual void end_by(std::chrono::steady_clock::time_point) {}

  /// What waits for the dead: see ControlStatus.dead_locks.
  virtual std::vector<std::string> dead_locks() const { return {}; }

  /// How long the executor of a node has not come round; nothing: that is not known.
  virtual std::optional<std::chrono::nanoseconds> silence(std::uint64_t) const {
    return std::nullopt;
  }

  /// What a node that is not constructed yet waits for, in words; empty: nothing.
  virtual std::string wait_of(std::uint64_t) const { return {}; }
};

}  // namespace play_launch::container
