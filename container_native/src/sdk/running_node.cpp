#include <algorithm>
#include <play_launch/detail/running_node.hpp>

namespace play_launch::detail {
namespace {

constinit thread_local const RunningNode* running = nullptr;

}  // namespace

RunningNode::RunningNode(const char* name) noexcept : name_(name), before_(running) {
  running = this;
}

RunningNode::~RunningNode() { running = before_; }

std::string RunningNode::name() const { return name_ != nullptr ? name_ : ""; }

std::string RunningNode::full_name() {
  std::string name = running != nullptr ? running->name() : "";
  if (name.empty() || name.starts_with('/')) return name;
  // The logger's name is the node's with dots, which no name of a node has.
  std::ranges::replace(name, '.', '/');
  return "/" + name;
}

}  // namespace play_launch::detail
