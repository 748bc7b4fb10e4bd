#include "main/control_interface.hpp"

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/socket.h>

#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <play_launch_msgs/msg/control_accepted.hpp>
#include <play_launch_msgs/msg/control_cancel.hpp>
#include <play_launch_msgs/msg/control_load.hpp>
#include <play_launch_msgs/msg/control_query.hpp>
#include <play_launch_msgs/msg/control_rejected.hpp>
#include <play_launch_msgs/msg/control_status.hpp>
#include <play_launch_msgs/msg/control_unload.hpp>
#include <play_launch_msgs/msg/node_status.hpp>
#include <stdexcept>
#include <utility>

#include "base/failpoints.hpp"
#include "base/report.hpp"
#include "base/unique_fd.hpp"
#include "control/frames.hpp"

namespace play_launch::container {
namespace {

using control::Frame;
using control::FrameKind;
namespace msg = play_launch_msgs::msg;

/// See ControlStatus.nodes.
constexpr std::chrono::seconds kSilent{5};

static_assert(static_cast<std::uint8_t>(NodeState::constructing) == msg::NodeStatus::CONSTRUCTING);
static_assert(static_cast<std::uint8_t>(NodeState::loaded) == msg::NodeStatus::LOADED);
static_assert(static_cast<std::uint8_t>(NodeState::unloading) == msg::NodeStatus::UNLOADING);

msg::NodeStatus status_of(const NodeSnapshot& snapshot) {
  msg::NodeStatus status;
  status.unique_id = snapshot.entry.unique_id;
  status.attempt = snapshot.entry.attempt;
  status.state = static_cast<std::uint8_t>(snapshot.entry.state);
  status.full_node_name = snapshot.entry.full_name;
  status.pid = snapshot.entry.process.pid;
  status.start_time = snapshot.entry.process.start_time;
  status.elapsed_ns = snapshot.elapsed_ns;
  status.cpu_time_ns = snapshot.cpu_time_ns;
  status.silence_ns = snapshot.silence_ns;
  status.note = snapshot.note;
  return status;
}

}  // namespace

UniqueFd take_socket(const char* variable, int type) {
  const char* const text = std::getenv(variable);
  if (text == nullptr) {
    return {};
  }
  const std::string value = text;
  ::unsetenv(variable);
  int fd = -1;
  const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), fd);
  if (error != std::errc() || end != value.data() + value.size() || fd < 0) {
    throw std::runtime_error(std::string(variable) + "=" + value +
                             " is no file descriptor's number");
  }
  int found = 0;
  socklen_t size = sizeof found;
  if (::getsockopt(fd, SOL_SOCKET, SO_TYPE, &found, &size) != 0 || found != type) {
    throw std::runtime_error(std::string(variable) + "=" + value +
                             " is no open socket of its type; it is set by the supervisor only");
  }
  fd = move_to_high_number(fd);
  ::fcntl(fd, F_SETFD, FD_CLOEXEC);
  // spawn_guard had us killed with the supervisor. From here on the end of this socket reports its
  // death, and we leave in order: a killed process leaves its shared memory behind.
  ::prctl(PR_SET_PDEATHSIG, 0);
  return UniqueFd(fd);
}

ControlInterface::ControlInterface(UniqueFd socket, StopRequests& stop,
                                   std::function<void()> on_lost)
    : stop_(stop), on_lost_(std::move(on_lost)), channel_(std::move(socket)) {
  control::prepare_messages<msg::ControlHello, msg::ControlLoad, msg::ControlAccepted,
                            msg::ControlRejected, msg::ControlQuery, msg::ControlStatus,
                            msg::ControlCancel, msg::ControlUnload, ComponentEvent>();
  channel_.start(*this);
}

void ControlInterface::open(ObservableComponentManager& manager, const msg::ControlHello& hello) {
  manager_ = &manager;
  send(FrameKind::hello, hello);
  channel_.open_gate();
}

void ControlInterface::close(SteadyTime deadline) {
  channel_.flush(deadline);
  channel_.stop();
}

template <class Message>
void ControlInterface::send(FrameKind kind, const Message& message) {
  try {
    channel_.send(kind, control::encode(message));
  } catch (const std::exception& error) {
    report(std::string("a frame for the supervisor is lost: ") + error.what());
  }
}

void ControlInterface::reject(std::uint64_t attempt, std::uint64_t unique_id,
                              const std::string& reason) {
  msg::ControlRejected rejected;
  rejected.attempt = attempt;
  rejected.unique_id = unique_id;
  rejected.reason = reason;
  send(FrameKind::rejected, rejected);
}

void ControlInterface::on_event(const ComponentEvent& event) {
  if (!drops_event(event.event_type)) {
    send(FrameKind::event, event);
  }
}

bool ControlInterface::understands(const Frame& frame) {
  // To stop needs no payload, and is the one thing that a supervisor of another version must be
  // able to ask for.
  if (frame.kind == static_cast<std::uint16_t>(FrameKind::shutdown)) {
    return true;
  }
  if (!foreign_version_ && frame.version != control::kProtocolVersion) {
    foreign_version_ = true;
    report("the supervisor speaks version " + std::to_string(frame.version) +
           " of the control protocol, this container version " +
           std::to_string(control::kProtocolVersion) +
           ": obeying nothing but its order to stop; install both from one release");
  }
  return !foreign_version_;
}

void ControlInterface::on_frame(const Frame& frame) {
  if (!understands(frame)) {
    return;
  }
  switch (static_cast<FrameKind>(frame.kind)) {
    case FrameKind::hello:
      handle_hello(frame);
      return;
    case FrameKind::load:
      handle_load(frame);
      return;
    case FrameKind::query:
      handle_query(frame);
      return;
    case FrameKind::cancel:
      handle_cancel(frame);
      return;
    case FrameKind::unload:
      handle_unload(frame);
      return;
    case FrameKind::shutdown:
      hit(Failpoint::on_shutdown);
      manager_->refuse_loads();  // those that are in the channel already, too
      stop_.request(StopCause::shutdown);
      return;
    case FrameKind::accepted:
    case FrameKind::rejected:
    case FrameKind::event:
    case FrameKind::status:
      break;
  }
  report("skipped a frame of kind " + std::to_string(frame.kind) + " (" +
         std::to_string(frame.payload.size()) + " bytes), which no supervisor sends");
}

void ControlInterface::on_closed() {
  if (!channel_.has_its_socket()) {
    report(
        "the control channel's descriptor was closed or replaced within this process, by a system "
        "call that it does not see: a node must have done it. No client can command this container "
        "any more: stopping");
  }
  on_lost_();
  stop_.request(StopCause::closed);
}

void ControlInterface::on_protocol_error(const std::string& what) {
  report("the supervisor broke the control protocol: " + what);
  on_lost_();
  stop_.request(StopCause::protocol_error);
}

void ControlInterface::handle_hello(const Frame& frame) {
  const auto hello = control::decode<msg::ControlHello>(frame.payload);
  Frame announced = frame;
  announced.version = hello.protocol_version;
  understands(announced);
}

void ControlInterface::handle_load(const Frame& frame) {
  const auto message = control::decode<msg::ControlLoad>(frame.payload);
  if (message.attempt == 0) {
    reject(0, 0, "a load needs an attempt number other than 0");
    return;
  }
  const auto refusal = manager_->load(message, [this, &message](std::uint64_t unique_id) {
    if (hit(Failpoint::drop_accepted)) {
      return;
    }
    msg::ControlAccepted accepted;
    accepted.attempt = message.attempt;
    accepted.unique_id = unique_id;
    send(FrameKind::accepted, accepted);
  });
  if (refusal) {
    reject(message.attempt, 0, *refusal);
  }
}

void ControlInterface::handle_query(const Frame& frame) {
  const auto query = control::decode<msg::ControlQuery>(frame.payload);
  if (hit(Failpoint::ignore_query)) {
    return;
  }
  msg::ControlStatus status;
  status.query_id = query.query_id;
  status.dropped_frames = channel_.dropped();
  const DeathTotals totals = manager_->totals();
  status.crashes = totals.crashes;
  status.undertaken = totals.cleaned_up;
  status.leaked = totals.leaked;
  status.unquiesced = totals.unquiesced;
  status.dead_locks = manager_->dead_locks();
  for (const NodeSnapshot& snapshot : manager_->nodes(query.unique_ids, kSilent)) {
    status.nodes.push_back(status_of(snapshot));
  }
  send(FrameKind::status, status);
}

void ControlInterface::handle_cancel(const Frame& frame) {
  const auto cancel = control::decode<msg::ControlCancel>(frame.payload);
  if (const auto refusal = manager_->cancel(cancel.unique_id)) {
    reject(0, cancel.unique_id, *refusal);
  }
}

void ControlInterface::handle_unload(const Frame& frame) {
  const auto unload = control::decode<msg::ControlUnload>(frame.payload);
  if (const auto refusal = manager_->unload(unload.unique_id)) {
    reject(0, unload.unique_id, *refusal);
  }
}

}  // namespace play_launch::container
