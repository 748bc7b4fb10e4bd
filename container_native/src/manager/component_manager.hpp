#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <play_launch_msgs/msg/component_event.hpp>
#include <span>
#include <string>
#include <vector>

#include "components/component_options.hpp"
#include "hosts/node_host.hpp"
#include "manager/node_table.hpp"

namespace play_launch::container {

using ComponentEvent = play_launch_msgs::msg::ComponentEvent;

/// Gets every event, in the order in which they happened. Called with the manager locked:
/// must neither block nor call the manager.
class EventSink {
 public:
  virtual ~EventSink() = default;
  virtual void on_event(const ComponentEvent& event) = 0;
};

inline constexpr std::int64_t kSilenceUnknown = -1;

/// A node as the manager sees it at one moment.
struct NodeSnapshot {
  NodeEntry entry;
  std::int64_t elapsed_ns = 0;                // in its state
  std::int64_t cpu_time_ns = 0;               // of the constructing thread; 0 without one
  std::int64_t silence_ns = kSilenceUnknown;  // since its executor last came round
  std::string note;                           // what it waits for before its constructor
};

/// What has become of nodes that died without being asked to, since the start. See the fields of
/// the same names in play_launch_msgs/ControlStatus.
struct DeathTotals {
  std::uint32_t crashes = 0;
  std::uint32_t cleaned_up = 0;
  std::uint32_t leaked = 0;
  std::uint32_t unquiesced = 0;
};

/// Owns the table of nodes: takes up requests, lets a NodeHost carry them out, and reports to the
/// outcome as events. Any thread may call; no member waits for user code.
class ObservableComponentManager final : public NodeHostObserver {
 public:
  /// `host` must outlive the manager's last call into it, the manager all of the host's nodes.
  ObservableComponentManager(NodeHost& host, const ProcessIdentity& process);

  /// The sink gets all events until remove_sink() returns, before those that were added earlier:
  /// the control channel comes last and is served first.
  void add_sink(EventSink& sink);
  void remove_sink(EventSink& sink);

  /// Called with the manager locked when a load was taken up, before its first event.
  using OnAccepted = std::function<void(std::uint64_t unique_id)>;
  /// Takes up a request and returns at once; the outcome is an event. An attempt that was taken up
  /// before is only accepted again. Returns why the request was refused, if it was.
  std::optional<std::string> load(const LoadRequest& request, const OnAccepted& on_accepted);

  /// Begins to unload a node, also one that still constructs. The outcome is an event. Returns why
  /// the request was refused, if it was. `on_accepted` is called as in load().
  std::optional<std::string> unload(std::uint64_t unique_id, const OnAccepted& on_accepted = {});

  /// Gives up a load: see NodeHost::give_up(); a node that was loaded in the meantime is unloaded.
  /// Returns as unload().
  std::optional<std::string> cancel(std::uint64_t unique_id);

  /// The nodes with these ids that exist, or all for no ids; by unique_id. Behind them, loaded ones
  /// that were silent for `silent_too` or longer.
  std::vector<NodeSnapshot> nodes(
      std::span<const std::uint64_t> unique_ids = {},
      std::chrono::nanoseconds silent_too = std::chrono::nanoseconds::max()) const;

  /// Takes up no load any more: a stop was asked for.
  void refuse_loads();

  /// Takes up no load any more, has nodes spin no more, and begins to unload all. `on_empty` is
  /// called (once, with the manager locked) when none is left. `why` goes with the end of each
  /// node; empty: the stop was requested.
  void begin_stop(std::function<void()> on_empty, const std::string& why = "");
  bool empty() const;

  DeathTotals totals() const;
  /// See NodeHost::dead_locks().
  std::vector<std::string> dead_locks() const { return host_.dead_locks(); }

  void on_constructing(std::uint64_t unique_id, const ProcessIdentity& process,
                       clockid_t cpu_clock) override;
  bool on_loaded(std::uint64_t unique_id, const std::string& full_name) override;
  void on_load_failed(std::uint64_t unique_id, const std::string& reason) override;
  void on_gone(std::uint64_t unique_id, const std::string& why) override;
  void on_died(std::uint64_t unique_id, const NodeDeath& death) override;
  void on_cleaned_up(std::uint64_t unique_id, bool complete) override;

 private:
  std::optional<std::string> retire(std::uint64_t unique_id, const OnAccepted& on_accepted,
                                    const std::string& verdict);
  bool start_unloading(std::uint64_t unique_id, std::string& why_not);
  void load_failed(const NodeEntry& entry, const std::string& reason, const NodeDeath* death);
  void emit(const NodeEntry& entry, std::uint8_t type, const std::string& error = {});
  void send(const ComponentEvent& event);
  NodeSnapshot snapshot(const NodeEntry& entry, SteadyTime now) const;
  bool is_silent(const NodeEntry& entry, std::chrono::nanoseconds limit) const;
  void after_removal();

  NodeHost& host_;
  const ProcessIdentity process_;

  mutable std::mutex mutex_;  // guards what follows
  std::vector<EventSink*> sinks_;
  NodeTable table_;
  DeathTotals totals_;
  bool stopping_ = false;
  std::function<void()> on_empty_;
};

}  // namespace play_launch::container
