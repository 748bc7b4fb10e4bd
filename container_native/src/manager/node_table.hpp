#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <ctime>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "base/process.hpp"

namespace play_launch::container {

enum class NodeState : std::uint8_t { constructing = 0, loaded = 1, unloading = 2 };

using SteadyTime = std::chrono::steady_clock::time_point;

/// What the container knows of one node.
struct NodeEntry {
  std::uint64_t unique_id = 0;
  std::uint64_t attempt = 0;  // 0: not numbered, never a repetition
  std::string package_name;
  std::string plugin_name;
  std::string full_name;  // empty while unknown
  NodeState state = NodeState::constructing;
  SteadyTime since;         // when it entered `state`
  ProcessIdentity process;  // its process
  /// CPU clock of the constructing thread; valid only while `state` is constructing.
  std::optional<clockid_t> cpu_clock;
  /// Set: it is not wanted, and leaves once its constructor has returned.
  bool retired = false;
  /// Error message of its last event, when it was cancelled while constructing.
  std::string verdict;
};

/// The container's nodes and the decisions about them. Pure: no threads, clocks or I/O; code that
/// owns it serialises the calls.
class NodeTable {
 public:
  static constexpr std::size_t kMaxNodes = 4096;
  /// Attempts that are remembered in order to recognise a repeated request.
  static constexpr std::size_t kMaxAttempts = 4096;

  struct Acceptance {
    bool repeated = false;  // the attempt was accepted before; start nothing
    /// The name is taken: the load has failed for this reason, and there is no entry. A name that
    /// is not known before construction may be there several times, as in upstream's containers.
    std::optional<std::string> conflict;
  };
  /// Takes up a request to load what `node` says, and gives it its unique_id.
  Acceptance accept(NodeEntry& node);
  bool full() const { return entries_.size() >= kMaxNodes; }

  /// Construction began in `process`.
  void constructing(std::uint64_t unique_id, ProcessIdentity process, clockid_t cpu_clock);

  /// The node spins under that name. False: it must leave; the entry has the reason.
  bool loaded(std::uint64_t unique_id, const std::string& full_name, SteadyTime now);

  enum class Retirement {
    unknown,     // there is no such node
    when_built,  // it constructs; loaded() will answer that it must leave
    unload_now,  // it was loaded and is unloading now: the caller unloads it
    under_way    // it was unloading or retired already
  };
  /// The node is not wanted. `verdict` goes into its last event.
  Retirement retire(std::uint64_t unique_id, const std::string& verdict, SteadyTime now);

  /// Takes back a retirement that answered unload_now: unloading could not be started.
  void keep(std::uint64_t unique_id, SteadyTime now);

  /// Removes the entry and returns it. Nothing: there was none.
  std::optional<NodeEntry> remove(std::uint64_t unique_id);

  const NodeEntry* find(std::uint64_t unique_id) const;
  /// By unique_id.
  const std::map<std::uint64_t, NodeEntry>& entries() const { return entries_; }

 private:
  std::optional<std::string> name_conflict(const std::string& full_name) const;
  void remember_attempt(std::uint64_t attempt, std::uint64_t unique_id);

  std::map<std::uint64_t, NodeEntry> entries_;
  std::unordered_map<std::uint64_t, std::uint64_t> attempts_;  // attempt -> unique_id
  std::deque<std::uint64_t> attempt_order_;
  /// Of all containers of a process: they share a list of those that wait for a library.
  inline static std::atomic<std::uint64_t> last_id_{0};
};

}  // namespace play_launch::container
