#include "manager/node_table.hpp"

#include <utility>

namespace play_launch::container {
namespace {

const char* describe(NodeState state) {
  switch (state) {
    case NodeState::constructing:
      return "is still constructing";
    case NodeState::loaded:
      return "is loaded";
    case NodeState::unloading:
      return "is still being unloaded";
  }
  return "is here";
}

}  // namespace

NodeTable::Acceptance NodeTable::accept(NodeEntry& node) {
  const auto known = attempts_.find(node.attempt);
  if (known != attempts_.end()) {
    node.unique_id = known->second;
    return {true, std::nullopt};
  }
  node.unique_id = ++last_id_;
  remember_attempt(node.attempt, node.unique_id);
  std::optional<std::string> conflict = name_conflict(node.full_name);
  if (!conflict) {
    entries_.emplace(node.unique_id, node);
  }
  return {false, std::move(conflict)};
}

void NodeTable::remember_attempt(std::uint64_t attempt, std::uint64_t unique_id) {
  if (attempt == 0) {
    return;
  }
  attempts_.emplace(attempt, unique_id);
  attempt_order_.push_back(attempt);
  if (attempt_order_.size() > kMaxAttempts) {
    attempts_.erase(attempt_order_.front());
    attempt_order_.pop_front();
  }
}

void NodeTable::constructing(std::uint64_t unique_id, ProcessIdentity process,
                             clockid_t cpu_clock) {
  const auto found = entries_.find(unique_id);
  if (found != entries_.end()) {
    found->second.process = process;
    found->second.cpu_clock = cpu_clock;
  }
}

bool NodeTable::loaded(std::uint64_t unique_id, const std::string& full_name, SteadyTime now) {
  const auto found = entries_.find(unique_id);
  if (found == entries_.end()) {
    return false;
  }
  NodeEntry& entry = found->second;
  entry.cpu_clock.reset();
  entry.full_name = full_name;
  entry.since = now;
  entry.state = entry.retired ? NodeState::unloading : NodeState::loaded;
  return !entry.retired;
}

NodeTable::Retirement NodeTable::retire(std::uint64_t unique_id, const std::string& verdict,
                                        SteadyTime now) {
  const auto found = entries_.find(unique_id);
  if (found == entries_.end()) {
    return Retirement::unknown;
  }
  NodeEntry& entry = found->second;
  if (entry.retired) {
    return Retirement::under_way;
  }
  entry.retired = true;
  entry.verdict = verdict;
  if (entry.state == NodeState::constructing) {
    return Retirement::when_built;
  }
  entry.state = NodeState::unloading;
  entry.since = now;
  return Retirement::unload_now;
}

void NodeTable::keep(std::uint64_t unique_id, SteadyTime now) {
  const auto found = entries_.find(unique_id);
  if (found != entries_.end()) {
    found->second.retired = false;
    found->second.verdict.clear();
    found->second.state = NodeState::loaded;
    found->second.since = now;
  }
}

std::optional<NodeEntry> NodeTable::remove(std::uint64_t unique_id) {
  auto handle = entries_.extract(unique_id);
  if (handle.empty()) {
    return std::nullopt;
  }
  return std::move(handle.mapped());
}

const NodeEntry* NodeTable::find(std::uint64_t unique_id) const {
  const auto found = entries_.find(unique_id);
  return found == entries_.end() ? nullptr : &found->second;
}

std::optional<std::string> NodeTable::name_conflict(const std::string& full_name) const {
  if (full_name.empty()) {
    return std::nullopt;
  }
  for (const auto& [unique_id, entry] : entries_) {
    if (entry.full_name != full_name) {
      continue;
    }
    return "a node named " + full_name + " " + describe(entry.state) +
           " in this container (unique_id " + std::to_string(unique_id) + ", " + entry.plugin_name +
           "); give this one another name or namespace";
  }
  return std::nullopt;
}

}  // namespace play_launch::container
