#include "hosts/spawned/hosted_node.hpp"

#include <sys/socket.h>

#include <cerrno>
#include <ctime>
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

namespace msg = play_launch_msgs::msg;
using control::FrameKind;

std::pair<UniqueFd, UniqueFd> socket_pair() {
  int fds[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, fds) != 0) {
    throw std::system_error(errno, std::generic_category(), "socketpair");
  }
  return {UniqueFd(fds[0]), UniqueFd(fds[1])};
}

/// The only load of that process.
LoadRequest first_attempt(LoadRequest request) {
  request.attempt = 1;
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
  channel_->start(*this);
  channel_->open_gate();
}

HostedNode::~HostedNode() { channel_->stop(); }

std::string HostedNode::full_name() const {
  const std::lock_guard lock(mutex_);
  return loaded_ ? loaded_->full_node_name : std::string();
}

void HostedNode::ask_to_leave() {
  msg::ControlShutdown shutdown;
  shutdown.reason = "unloaded";
  channel_->send(FrameKind::shutdown, control::encode(shutdown));
}

void HostedNode::on_frame(const control::Frame& frame) {
  ComponentEvent event;
  if (frame.kind == static_cast<std::uint16_t>(FrameKind::event)) {
    event = control::decode<ComponentEvent>(frame.payload);
  } else if (frame.kind == static_cast<std::uint16_t>(FrameKind::rejected)) {
    event.event_type = ComponentEvent::LOAD_FAILED;
    event.error_message = control::decode<msg::ControlRejected>(frame.payload).reason;
  } else {
    return;
  }
  {
    const std::lock_guard lock(mutex_);
    switch (event.event_type) {
      case ComponentEvent::LOADED:
        loaded_ = std::move(event);
        break;
      case ComponentEvent::LOAD_FAILED:
        failed_ = std::move(event);
        break;
      case ComponentEvent::UNLOADED:
        unloaded_ = event;
        break;
      default:
        return;
    }
  }
  ring(doorbell());
}

void HostedNode::on_closed() {
  const std::lock_guard lock(mutex_);
  closed_ = true;
  ring(doorbell());
}

void HostedNode::on_protocol_error(const std::string& what) {
  report(label() + ": its process broke the control protocol: " + what);
  on_closed();
}

void HostedNode::tell(NodeHostObserver& observer, IsolationTotals& totals) {
  if (!told_constructing_) {
    told_constructing_ = true;
    clockid_t cpu_clock = CLOCK_THREAD_CPUTIME_ID;
    ::clock_getcpuclockid(process_->identity().pid, &cpu_clock);
    observer.on_constructing(unique_id(), process_->identity(), cpu_clock);
  }
  if (!dead_ && process_->reap()) {
    dead_ = true;
    channel_->expect_no_more();
  }
  std::unique_lock lock(mutex_);
  if (!told_loaded_ && loaded_) {
    const ComponentEvent loaded = *loaded_;
    lock.unlock();
    tell_loaded(observer, loaded);
    lock.lock();
  }
  if (failed_) {
    leave();
  }
  // What it wrote before its end is read before the end of the channel is.
  const bool complete = dead_ && closed_;
  lock.unlock();
  if (complete && !told_end_) {
    told_end_ = true;
    tell_end(observer, totals);
  }
}

void HostedNode::tell_loaded(NodeHostObserver& observer, const ComponentEvent& loaded) {
  told_loaded_ = true;
  if (!observer.on_loaded(unique_id(), loaded.full_node_name)) {
    leave();
  }
}

void HostedNode::tell_end(NodeHostObserver& observer, IsolationTotals& totals) {
  const ProcessEnd& end = process_->end();
  const bool in_order = end.signal == 0 && end.exit_code == 0;
  if (failed_) {
    observer.on_load_failed(unique_id(), failed_->error_message);
    return;
  }
  if (in_order && unloaded_) {
    observer.on_gone(unique_id(), unloaded_->error_message);
    return;
  }
  ++totals.crashes;
  ++totals.undertaken;  // by the kernel
  NodeDeath death;
  death.exit_code = end.exit_code;
  death.signal = end.signal;
  death.reason = describe(end);
  if (told_loaded_) {
    observer.on_crashed(unique_id(), death);
  } else {
    observer.on_load_crashed(unique_id(), death);
  }
}

}  // namespace play_launch::container
