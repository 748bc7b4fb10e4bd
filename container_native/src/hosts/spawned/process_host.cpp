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
    arguments_.emplace_back("--use_multi_threaded_executor");
    if (!executor.by_cpus) {  // else of those that its process may use
      arguments_.insert(arguments_.end(), {"--thread_num", std::to_string(executor.threads)});
    }
  }
  if (core_dumps) {
    arguments_.emplace_back("--core_dumps");
  }
  ros_arguments_.emplace_back("--ros-args");
  ros_arguments_.insert(ros_arguments_.end(), ros_arguments.begin(), ros_arguments.end());
}

std::shared_ptr<IsolatedNode> ProcessHost::start(std::uint64_t unique_id, LoadRequest request,
                                                 NodeResources /*resources*/, int doorbell) {
  std::vector<std::string> arguments = arguments_;
  for (const std::string& text : request.resources) {
    arguments.insert(arguments.end(), {"--resource", text});
  }
  if (request.lock_memory) {
    arguments.emplace_back("--lock_memory");
  }
  arguments.insert(arguments.end(), ros_arguments_.begin(), ros_arguments_.end());
  return std::make_shared<HostedNode>(unique_id, arguments, std::move(request), doorbell);
}

}  // namespace play_launch::container
