#include "hosts/spawned/process_host.hpp"

#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <play_launch_msgs/msg/component_event.hpp>
#include <play_launch_msgs/msg/control_load.hpp>
#include <play_launch_msgs/msg/control_rejected.hpp>
#include <play_launch_msgs/msg/control_shutdown.hpp>
#include <string_view>
#include <system_error>
#include <utility>

#include "base/report.hpp"
#include "base/scheduling.hpp"
#include "base/unique_fd.hpp"
#include "control/frames.hpp"
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
                                                 NodeResources /*resources*/, int event_fd) {
  std::vector<std::string> arguments = arguments_;
  for (const std::string& text : request.resources) {
    arguments.insert(arguments.end(), {"--resource", text});
  }
  if (request.lock_memory) {
    arguments.emplace_back("--lock_memory");
  }
  arguments.insert(arguments.end(), ros_arguments_.begin(), ros_arguments_.end());
  return std::make_shared<HostedNode>(unique_id, arguments, std::move(request), event_fd);
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

constexpr const char* kProgram = "/proc/self/exe";
/// waitid() by descriptor, for C libraries that lack the name.
constexpr auto kByDescriptor = static_cast<idtype_t>(3);

[[noreturn]] void fail(int error, const char* what) {
  throw std::system_error(error, std::generic_category(), what);
}

/// What the new process changes about itself before it becomes another program.
class SpawnPlan {
 public:
  explicit SpawnPlan(int inherited_fd) {
    ::posix_spawn_file_actions_init(&actions_);
    ::posix_spawnattr_init(&attributes_);
    // Onto itself: that clears the flag which would close it.
    ::posix_spawn_file_actions_adddup2(&actions_, inherited_fd, inherited_fd);
    sigset_t none;
    sigemptyset(&none);
    sigset_t all;
    sigfillset(&all);
    ::posix_spawnattr_setsigmask(&attributes_, &none);
    ::posix_spawnattr_setsigdefault(&attributes_, &all);
    ::posix_spawnattr_setflags(&attributes_, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
  }
  ~SpawnPlan() {
    ::posix_spawn_file_actions_destroy(&actions_);
    ::posix_spawnattr_destroy(&attributes_);
  }
  SpawnPlan(const SpawnPlan&) = delete;
  SpawnPlan& operator=(const SpawnPlan&) = delete;

  const posix_spawn_file_actions_t* actions() const { return &actions_; }
  const posix_spawnattr_t* attributes() const { return &attributes_; }

 private:
  posix_spawn_file_actions_t actions_{};
  posix_spawnattr_t attributes_{};
};

/// The environment with that control channel.
std::vector<std::string> environment(int control_fd) {
  const std::string prefix = std::string(control::kSocketVariable) + "=";
  std::vector<std::string> entries{prefix + std::to_string(control_fd)};
  for (char** entry = environ; *entry != nullptr; ++entry) {
    if (!std::string_view(*entry).starts_with(prefix)) {
      entries.emplace_back(*entry);
    }
  }
  return entries;
}

std::vector<char*> pointers(std::vector<std::string>& texts) {
  std::vector<char*> result;
  for (std::string& text : texts) {
    result.push_back(text.data());
  }
  result.push_back(nullptr);
  return result;
}

/// Starts this very program with these arguments, and `control_socket` as its control channel.
pid_t start_process(const std::vector<std::string>& arguments, const UniqueFd& control_socket) {
  std::vector<std::string> argv{"component_container"};
  argv.insert(argv.end(), arguments.begin(), arguments.end());
  std::vector<std::string> variables = environment(control_socket.get());
  const SpawnPlan plan(control_socket.get());
  pid_t pid = 0;
  if (const int error = ::posix_spawn(&pid, kProgram, plan.actions(), plan.attributes(),
                                      pointers(argv).data(), pointers(variables).data());
      error != 0) {
    fail(error, "posix_spawn");
  }
  return pid;
}

}  // namespace

HostedNode::HostedNode(std::uint64_t unique_id, const std::vector<std::string>& arguments,
                       LoadRequest request, int event_fd)
    : IsolatedNode(unique_id, event_fd), request_(std::move(request)) {
  auto [ours, theirs] = socket_pair();
  channel_.emplace(std::move(ours));
  channel_->send(FrameKind::load, control::encode(first_attempt(request_)));
  channel_->start(*this);
  const pid_t pid = start_process(arguments, theirs);
  process_fd_.reset(static_cast<int>(::syscall(SYS_pidfd_open, pid, 0)));
  if (!process_fd_) {
    const int error = errno;
    ::kill(pid, SIGKILL);  // it is not reaped, so the pid is still its own
    ::waitpid(pid, nullptr, 0);
    fail(error, "pidfd_open");
  }
  process_ = identity_of(pid);
  life_.add(NodeLife::constructing);
  channel_->open_gate();
}

HostedNode::~HostedNode() {
  channel_->stop();
  if (!is_reaped_) {
    signal(SIGKILL);
    reap(0);
  }
}

std::string HostedNode::full_name() const {
  return has_any(life_.so_far(), NodeLife::spinning) ? full_name_ : "";
}

void HostedNode::ask_to_leave() {
  is_asked_ = true;
  msg::ControlShutdown shutdown;
  shutdown.reason = "unloaded";
  channel_->send(FrameKind::shutdown, control::encode(shutdown));
}

bool HostedNode::signal(int number) {
  return !is_reaped_ &&
         ::syscall(SYS_pidfd_send_signal, process_fd_.get(), number, nullptr, 0) == 0;
}

/// `options` of waitid(): WNOHANG, or 0 to wait for its death.
void HostedNode::reap(int options) {
  siginfo_t info{};
  const NotRealTime reaping;
  if (::waitid(kByDescriptor, static_cast<id_t>(process_fd_.get()), &info, WEXITED | options) !=
          0 ||
      info.si_pid == 0) {
    return;
  }
  is_reaped_ = true;
  if (info.si_code == CLD_EXITED) {
    death_.exit_code = info.si_status;
    death_.reason = "exit status " + std::to_string(info.si_status);
  } else {
    death_.signal = info.si_status;
    death_.reason = isolation::signal_name(info.si_status);
  }
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
    notify_eventfd(event_fd());
  }
}

void HostedNode::on_closed() {
  closed_ = true;
  notify_eventfd(event_fd());
}

void HostedNode::on_protocol_error(const std::string& what) {
  report(label() + ": its process broke the control protocol: " + what);
  on_closed();
}

NodeLife HostedNode::look() {
  if (!is_reaped_) {
    reap(WNOHANG);
    if (is_reaped_) {
      channel_->expect_no_more();
    }
  }
  // What it wrote before its end is read before the end of the channel is.
  const bool complete = is_reaped_ && closed_;
  const NodeLife life = life_.so_far();
  if (has_any(life, NodeLife::failed)) {
    leave();
  }
  if (complete && !has_any(life, NodeLife::finished)) {
    // A signal from outside makes its process stop in order, too: that is no node that left.
    const bool was_stopped = !is_asked_ && why_it_left_.empty() && has_any(life, NodeLife::left);
    const bool clean = death_.signal == 0 && death_.exit_code == 0 && !was_stopped;
    if (was_stopped) {
      death_.reason = "its process was stopped from outside (" + death_.reason + ")";
    }
    // How a process ends that holds no node does not matter.
    life_.add(ending(life, clean || has_any(life, NodeLife::failed)) | NodeLife::finished);
  }
  return life_.so_far();
}

}  // namespace play_launch::container
