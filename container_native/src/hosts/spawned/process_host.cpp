#include "hosts/spawned/process_host.hpp"

#include <sys/socket.h>

#include <cerrno>
#include <play_launch_msgs/msg/component_event.hpp>
#include <play_launch_msgs/msg/control_load.hpp>
#include <play_launch_msgs/msg/control_rejected.hpp>
#include <play_launch_msgs/msg/control_shutdown.hpp>
#include <system_error>
#include <utility>

#include "base/doorbell.hpp"
#include "base/report.hpp"
#include "control/messages.hpp"
#include "isolation/crash/symbolise.hpp"

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

namespace {

namespace msg = play_launch_msgs::msg;
using control::FrameKind;

std::pair<UniqueFd, UniqueFd> socket_pair() {
  int fds[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, fds) != 0) {
    throw std::system_error(errno, std::generic_category(), "socketpair");
  }
  return {UniqueFd(fds[0]), UniqueFd(fds[1])};
}

/// The only load of that process, which has asked for its resources when it began.
LoadRequest first_attempt(LoadRequest request) {
  request.attempt = 1;
  request.resources.clear();
  request.lock_memory = false;
  return request;
}

std::string describe(const ProcessEnd& end) {
  return end.signal != 0 ? isolation::signal_name(end.signal)
                         : "exit status " + std::to_string(end.exit_code);
}

}  // namespace

HostedNode::HostedNode(std::uint64_t unique_id, const std::vector<std::string>& arguments,
                       LoadRequest request, int doorbell)
    : IsolatedNode(unique_id, doorbell), request_(std::move(request)) {
  auto [ours, theirs] = socket_pair();
  process_.emplace(arguments, theirs);
  channel_.emplace(std::move(ours));
  channel_->send(FrameKind::load, control::encode(first_attempt(request_)));
  life_.add(NodeLife::constructing);
  channel_->start(*this);
  channel_->open_gate();
}

HostedNode::~HostedNode() { channel_->stop(); }

std::string HostedNode::full_name() const {
  return has_any(life_.so_far(), NodeLife::spinning) ? full_name_ : "";
}

void HostedNode::ask_to_leave() {
  msg::ControlShutdown shutdown;
  shutdown.reason = "unloaded";
  channel_->send(FrameKind::shutdown, control::encode(shutdown));
}

bool HostedNode::signal(int number) {
  if (process_->is_reaped()) {
    return false;
  }
  process_->signal(number);
  return true;
}

void HostedNode::on_frame(const control::Frame& frame) {
  if (frame.kind == static_cast<std::uint16_t>(FrameKind::rejected)) {
    note(NodeLife::failed, failure_, control::decode<msg::ControlRejected>(frame.payload).reason);
  }
  if (frame.kind != static_cast<std::uint16_t>(FrameKind::event)) {
    return;
  }
  const auto event = control::decode<msg::ComponentEvent>(frame.payload);
  switch (event.event_type) {
    case msg::ComponentEvent::LOADED:
      note(NodeLife::spinning, full_name_, event.full_node_name);
      break;
    case msg::ComponentEvent::LOAD_FAILED:
      note(NodeLife::failed, failure_, event.error_message);
      break;
    case msg::ComponentEvent::UNLOADED:
      note(NodeLife::left, why_it_left_, event.error_message);
      break;
    default:
      break;
  }
}

void HostedNode::note(NodeLife part, std::string& text, const std::string& what) {
  if (!has_any(life_.so_far(), part)) {
    text = what;
    life_.add(part);
    ring(doorbell());
  }
}

void HostedNode::on_closed() {
  closed_ = true;
  ring(doorbell());
}

void HostedNode::on_protocol_error(const std::string& what) {
  report(label() + ": its process broke the control protocol: " + what);
  on_closed();
}

NodeLife HostedNode::look() {
  if (!process_->is_reaped() && process_->reap()) {
    channel_->expect_no_more();
  }
  // What it wrote before its end is read before the end of the channel is.
  const bool complete = process_->is_reaped() && closed_;
  const NodeLife life = life_.so_far();
  if (has_any(life, NodeLife::failed)) {
    leave();
  }
  if (complete && !has_any(life, NodeLife::buried)) {
    const ProcessEnd& end = process_->end();
    const bool clean = end.signal == 0 && end.exit_code == 0;
    // How a process ends that holds no node does not matter.
    life_.add(ending(life, clean || has_any(life, NodeLife::failed)) | NodeLife::buried);
  }
  return life_.so_far();
}

NodeDeath HostedNode::death() {
  NodeDeath death;
  death.exit_code = process_->end().exit_code;
  death.signal = process_->end().signal;
  death.reason = describe(process_->end());
  return death;
}

}  // namespace play_launch::container
