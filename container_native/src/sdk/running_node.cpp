#include <algorithm>
#include <play_launch/detail/running_node.hpp>

namespace play_launch::detail {
namespace {

constinit thread_local const char* running = nullptr;

}  // namespace

RunningNode::RunningNode(const char* name) noexcept : before_(running) { running = name; }

RunningNode::~RunningNode() { running = before_; }

std::string RunningNode::full_name() {
  if (running == nullptr) return "";
  std::string name = running;
  if (name.starts_with('/')) return name;
  // The logger's name is the node's with dots, which no name of a node has.
  std::ranges::replace(name, '.', '/');
  return "/" + name;
}

}  // namespace play_launch::detail
