#include "manager/component_manager.hpp"

#include <algorithm>
#include <chrono>
#include <csignal>
#include <exception>
#include <utility>

#include "base/failpoints.hpp"
#include "base/report.hpp"
#include "components/component_options.hpp"

namespace play_launch::container {
namespace {

using Clock = std::chrono::steady_clock;

constexpr const char* kCancelled = "cancelled";
constexpr const char* kNotInOrder = "it did not leave in order: ";

void set_stamp(builtin_interfaces::msg::Time& stamp, std::chrono::nanoseconds age = {}) {
  constexpr std::int64_t kNanosecondsPerSecond = 1'000'000'000;
  const std::int64_t then = (std::chrono::duration_cast<std::chrono::nanoseconds>(
                                 std::chrono::system_clock::now().time_since_epoch()) -
                             age)
                                .count();
  stamp.sec = static_cast<std::int32_t>(then / kNanosecondsPerSecond);
  stamp.nanosec = static_cast<std::uint32_t>(then % kNanosecondsPerSecond);
}

std::int64_t cpu_time_ns(clockid_t clock) {
  timespec time{};
  return ::clock_gettime(clock, &time) == 0
             ? static_cast<std::int64_t>(time.tv_sec) * 1'000'000'000 + time.tv_nsec
             : 0;
}

/// An event of that type about the node, now.
ComponentEvent event_of(const NodeEntry& entry, std::uint8_t type) {
  ComponentEvent event;
  set_stamp(event.stamp);
  event.event_type = type;
  event.unique_id = entry.unique_id;
  event.attempt = entry.attempt;
  event.full_node_name = entry.full_name;
  event.package_name = entry.package_name;
  event.plugin_name = entry.plugin_name;
  event.pid = entry.process.pid;
  event.start_time = entry.process.start_time;
  return event;
}

void add_death(ComponentEvent& event, const NodeDeath& death) {
  event.exit_code = death.exit_code;
  event.signal = death.signal;
  event.backtrace = death.backtrace;
  event.modules = death.modules;
  if (death.when) {
    set_stamp(event.stamp, Clock::now() - *death.when);
  }
}

/// Whether a node that should leave faulted instead. A node that does not leave in time is ended by
/// us, by systemd or by a person, with one of these signals: that is no fault of its code.
bool faulted(const NodeDeath& death) {
  switch (death.signal) {
    case 0:
      return death.exit_code != 0;
    case SIGHUP:
    case SIGINT:
    case SIGKILL:
    case SIGTERM:
      return false;
    default:
      return true;
  }
}

std::string no_such_node(std::uint64_t unique_id) {
  return "No node found with unique_id: " + std::to_string(unique_id);  // as rclcpp_components
}

}  // namespace

ObservableComponentManager::ObservableComponentManager(NodeHost& host,
                                                       const ProcessIdentity& process)
    : host_(host), process_(process) {
  host_.set_observer(*this);
}

void ObservableComponentManager::add_sink(EventSink& sink) {
  const std::lock_guard lock(mutex_);
  sinks_.insert(sinks_.begin(), &sink);
}

void ObservableComponentManager::remove_sink(EventSink& sink) {
  const std::lock_guard lock(mutex_);
  std::erase(sinks_, &sink);
}

std::optional<std::string> ObservableComponentManager::load(const LoadRequest& request,
                                                            const OnAccepted& on_accepted) {
  NodeEntry node;
  node.attempt = request.attempt;
  node.package_name = request.package_name;
  node.plugin_name = request.plugin_name;
  node.full_name = expected_full_name(request).value_or("");
  node.process = process_;
  node.since = Clock::now();
  const std::lock_guard lock(mutex_);
  if (stopping_) {
    return "the container is stopping";
  }
  if (table_.full()) {
    return "the container already has " + std::to_string(NodeTable::kMaxNodes) + " nodes";
  }
  const NodeTable::Acceptance acceptance = table_.accept(node);
  on_accepted(node.unique_id);
  if (acceptance.repeated) {
    return std::nullopt;
  }
  hit(Failpoint::after_accept);
  emit(node, ComponentEvent::LOADING);
  if (acceptance.conflict) {
    emit(node, ComponentEvent::LOAD_FAILED, *acceptance.conflict);
    return std::nullopt;
  }
  try {
    host_.load(node.unique_id, request);
  } catch (const std::exception& error) {
    table_.remove(node.unique_id);
    emit(node, ComponentEvent::LOAD_FAILED, std::string("cannot start loading: ") + error.what());
  }
  return std::nullopt;
}

std::optional<std::string> ObservableComponentManager::unload(std::uint64_t unique_id,
                                                              const OnAccepted& on_accepted) {
  return retire(unique_id, on_accepted, "");
}

std::optional<std::string> ObservableComponentManager::cancel(std::uint64_t unique_id) {
  return retire(unique_id, {}, kCancelled);
}

std::optional<std::string> ObservableComponentManager::retire(std::uint64_t unique_id,
                                                              const OnAccepted& on_accepted,
                                                              const std::string& verdict) {
  const std::lock_guard lock(mutex_);
  const NodeEntry* const entry = table_.find(unique_id);
  if (entry == nullptr) {
    return no_such_node(unique_id);
  }
  // A load that never came to its end is distinguished from a node that was there.
  const bool constructing = entry->state == NodeState::constructing;
  const NodeTable::Retirement retirement =
      table_.retire(unique_id, constructing ? kCancelled : verdict, Clock::now());
  std::string why_not;
  if (retirement == NodeTable::Retirement::unload_now && !start_unloading(unique_id, why_not)) {
    table_.keep(unique_id, Clock::now());
    return why_not;
  }
  if (on_accepted) {
    on_accepted(unique_id);
  }
  if (retirement == NodeTable::Retirement::when_built) {
    host_.give_up(unique_id);
  }
  return std::nullopt;
}

bool ObservableComponentManager::start_unloading(std::uint64_t unique_id, std::string& why_not) {
  try {
    host_.unload(unique_id);
    return true;
  } catch (const std::exception& error) {
    why_not = std::string("cannot start unloading: ") + error.what();
    report("unique_id " + std::to_string(unique_id) + ": " + why_not);
    return false;
  }
}

std::vector<NodeSnapshot> ObservableComponentManager::nodes(
    std::span<const std::uint64_t> unique_ids, std::chrono::nanoseconds silent_too) const {
  std::vector<NodeSnapshot> snapshots;
  const std::lock_guard lock(mutex_);
  const SteadyTime now = Clock::now();
  for (const std::uint64_t unique_id : unique_ids) {
    if (const NodeEntry* const entry = table_.find(unique_id)) {
      snapshots.push_back(snapshot(*entry, now));
    }
  }
  for (const auto& [unique_id, entry] : table_.entries()) {
    const bool listed =
        std::find(unique_ids.begin(), unique_ids.end(), unique_id) != unique_ids.end();
    if (unique_ids.empty() || (!listed && is_silent(entry, silent_too))) {
      snapshots.push_back(snapshot(entry, now));
    }
  }
  return snapshots;
}

NodeSnapshot ObservableComponentManager::snapshot(const NodeEntry& entry, SteadyTime now) const {
  NodeSnapshot snapshot;
  snapshot.entry = entry;
  snapshot.elapsed_ns =
      std::chrono::duration_cast<std::chrono::nanoseconds>(now - entry.since).count();
  snapshot.cpu_time_ns = entry.cpu_clock ? cpu_time_ns(*entry.cpu_clock) : 0;
  if (const auto silence = host_.silence(entry.unique_id)) {
    snapshot.silence_ns = silence->count();
  }
  if (entry.state == NodeState::constructing) {
    snapshot.note = host_.wait_of(entry.unique_id);
  }
  return snapshot;
}

bool ObservableComponentManager::is_silent(const NodeEntry& entry,
                                           std::chrono::nanoseconds limit) const {
  if (entry.state != NodeState::loaded || limit == std::chrono::nanoseconds::max()) {
    return false;
  }
  const auto silence = host_.silence(entry.unique_id);
  return silence && *silence >= limit;
}

void ObservableComponentManager::refuse_loads() {
  const std::lock_guard lock(mutex_);
  stopping_ = true;
}

void ObservableComponentManager::begin_stop(std::function<void()> on_empty,
                                            const std::string& why) {
  std::vector<std::uint64_t> to_unload;
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    on_empty_ = std::move(on_empty);
    std::vector<std::uint64_t> unique_ids;
    for (const auto& [unique_id, entry] : table_.entries()) {
      unique_ids.push_back(unique_id);
    }
    for (const std::uint64_t unique_id : unique_ids) {
      const bool constructing = table_.find(unique_id)->state == NodeState::constructing;
      if (table_.retire(unique_id, constructing && why.empty() ? kCancelled : why, Clock::now()) ==
          NodeTable::Retirement::unload_now) {
        to_unload.push_back(unique_id);
      }
    }
  }
  // From here on isolated nodes leave: their end is the requested one.
  host_.stop_spinning();
  const std::lock_guard lock(mutex_);
  for (const std::uint64_t unique_id : to_unload) {
    std::string why_not;
    if (table_.find(unique_id) != nullptr) {
      start_unloading(unique_id, why_not);  // if not, the end of the stop reports the node
    }
  }
  after_removal();
}

DeathTotals ObservableComponentManager::totals() const {
  const std::lock_guard lock(mutex_);
  return totals_;
}

bool ObservableComponentManager::empty() const {
  const std::lock_guard lock(mutex_);
  return table_.entries().empty();
}

void ObservableComponentManager::on_constructing(std::uint64_t unique_id,
                                                 const ProcessIdentity& process,
                                                 clockid_t cpu_clock) {
  const std::lock_guard lock(mutex_);
  table_.constructing(unique_id, process, cpu_clock);
}

bool ObservableComponentManager::on_loaded(std::uint64_t unique_id, const std::string& full_name) {
  const std::lock_guard lock(mutex_);
  const bool wanted = table_.loaded(unique_id, full_name, Clock::now());
  if (wanted) {
    emit(*table_.find(unique_id), ComponentEvent::LOADED);
  }
  return wanted;
}

void ObservableComponentManager::on_load_failed(std::uint64_t unique_id,
                                                const std::string& reason) {
  const std::lock_guard lock(mutex_);
  if (const std::optional<NodeEntry> entry = table_.remove(unique_id)) {
    load_failed(*entry, reason, nullptr);
  }
}

/// `death` is null unless its process died.
void ObservableComponentManager::load_failed(const NodeEntry& entry, const std::string& reason,
                                             const NodeDeath* death) {
  ComponentEvent event =
      event_of(entry, entry.retired ? ComponentEvent::UNLOADED : ComponentEvent::LOAD_FAILED);
  event.error_message = reason;
  if (entry.retired) {
    const bool was_ended = death != nullptr && !faulted(*death);
    event.error_message =
        entry.verdict + "; " + (was_ended ? kNotInOrder : "loading failed as well: ") + reason;
  }
  if (death != nullptr) {
    add_death(event, *death);
  }
  send(event);
  after_removal();
}

void ObservableComponentManager::on_gone(std::uint64_t unique_id, const std::string& why) {
  const std::lock_guard lock(mutex_);
  const std::optional<NodeEntry> entry = table_.remove(unique_id);
  if (!entry) {
    return;
  }
  emit(*entry, ComponentEvent::UNLOADED, entry->verdict.empty() ? why : entry->verdict);
  after_removal();
}

void ObservableComponentManager::on_died(std::uint64_t unique_id, const NodeDeath& death) {
  const std::lock_guard lock(mutex_);
  ++totals_.crashes;
  totals_.unquiesced += death.unquiesced ? 1 : 0;
  const std::optional<NodeEntry> entry = table_.remove(unique_id);
  if (!entry) {
    return;
  }
  if (entry->state == NodeState::constructing) {
    load_failed(*entry, death.reason, &death);
    return;
  }
  ComponentEvent event = event_of(*entry, ComponentEvent::CRASHED);
  event.error_message = death.reason;
  if (entry->retired) {
    // It is not wanted back, but a destructor that faults is reported as a crash.
    if (!faulted(death)) {
      event.event_type = ComponentEvent::UNLOADED;
    }
    event.error_message =
        (entry->verdict.empty() ? "" : entry->verdict + "; ") + kNotInOrder + death.reason;
  }
  add_death(event, death);
  send(event);
  after_removal();
}

void ObservableComponentManager::on_cleaned_up(std::uint64_t, bool complete) {
  const std::lock_guard lock(mutex_);
  ++(complete ? totals_.cleaned_up : totals_.leaked);
}

void ObservableComponentManager::after_removal() {
  if (stopping_ && on_empty_ && table_.entries().empty()) {
    std::exchange(on_empty_, nullptr)();
  }
}

void ObservableComponentManager::emit(const NodeEntry& entry, std::uint8_t type,
                                      const std::string& error) {
  ComponentEvent event = event_of(entry, type);
  event.error_message = error;
  send(event);
}

void ObservableComponentManager::send(const ComponentEvent& event) {
  for (EventSink* const sink : sinks_) {
    sink->on_event(event);
  }
}

}  // namespace play_launch::container
