#include "hosts/spawned/process_host.hpp"

#include <utility>

#include "hosts/spawned/hosted_node.hpp"

namespace play_launch::container {
namespace {

/// Seconds for the node in a callback, or a destructor, when its process is asked to leave; this
/// container itself knows more drastic ways after that.
constexpr const char* kStopTimeout = "10";

}  // namespace

ProcessHost::ProcessHost(BackendList backends, const ExecutorChoice& executor, bool core_dumps,
                         const std::vector<std::string>& ros_arguments)
    : IsolatedHost(std::move(backends)), arguments_{"--hosted", "--stop_timeout", kStopTimeout} {
  if (executor.multi_threaded) {
    arguments_.insert(arguments_.end(), {"--use_multi_threaded_executor", "--thread_num",
                                         std::to_string(executor.threads)});
  }
  if (core_dumps) {
    arguments_.emplace_back("--core_dumps");
  }
  arguments_.emplace_back("--ros-args");
  arguments_.insert(arguments_.end(), ros_arguments.begin(), ros_arguments.end());
}

std::shared_ptr<IsolatedNode> ProcessHost::start(std::uint64_t unique_id, LoadRequest request,
                                                 int doorbell) {
  return std::make_shared<HostedNode>(unique_id, arguments_, std::move(request), doorbell);
}

}  // namespace play_launch::container
