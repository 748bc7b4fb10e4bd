#include "main/container.hpp"

#include <rcl/context.h>
#include <rmw/rmw.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <future>
#include <play_launch/detail/running_node.hpp>
#include <string>
#include <utility>
#include <vector>

#include "base/failpoints.hpp"
#include "base/process.hpp"
#include "base/report.hpp"
#include "base/scheduling.hpp"
#include "fastdds/waits.hpp"
#include "isolation/crash/symbolise.hpp"
#include "main/host_choice.hpp"
#include "main/stop.hpp"
#include "overrides/type_supports.hpp"

namespace play_launch::container {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

constexpr const char* kDefaultName = "ComponentManager";

/// For a second request to stop.
constexpr auto kSecondStopLimit = 200ms;
/// For the supervisor to read the last events.
constexpr auto kFlushLimit = 500ms;
/// For the names in the report of the container's own crash, which the dying thread awaits for 1 s.
constexpr auto kLookUpLimit = 500ms;

bool is_orphaned(StopCause cause) {
  return cause == StopCause::closed || cause == StopCause::protocol_error;
}

int exit_code(StopCause cause, bool hosted) {
  if (cause == StopCause::context) {
    return hosted ? kExitOk : kExitContext;  // in a process of its own, the node may end itself
  }
  return cause == StopCause::protocol_error ? kExitProtocol : kExitOk;
}

std::terminate_handler next_terminate_handler = nullptr;

/// An exception that no code of a node catches ends the process of the node, or the container where
/// nodes have none of their own: the log has whose callback threw what.
[[noreturn]] void on_terminate() {
  detail::RunningNode::log_uncaught_exception();
  if (next_terminate_handler != nullptr) {
    next_terminate_handler();
  }
  std::abort();
}

std::string seconds_text(Clock::duration duration) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.1f s",
                std::chrono::duration<double>(duration).count());
  return text.data();
}

}  // namespace

Container::Container(const Options& options, SharedParts& shared, StopRequests& stop,
                     UniqueFd control_socket, const std::vector<std::string>& arguments)
    : options_(options), shared_(shared), stop_(stop) {
  if (control_socket) {
    control_.emplace(std::move(control_socket), stop_, [this] {
      end_process_by(
          Clock::now() + kOrphanLifeLimit, kExitOk,
          "the channel to the supervisor has ended, and stopping takes too long: leaving");
    });
  }
  // The first node of the context, and the last to go: the participant and its threads come with
  // it, and must not depend on the end of a component.
  if (!options_.hosted) {
    NodeOptions node_options;
    node_options.context = shared_.backends.context();
    node_options.arguments = arguments;
    node_options.start_parameter_services = false;  // RosInterface does
    const fastdds::Withholding until_it_listens;
    node_ = std::make_shared<Node>(kDefaultName, node_options);
  }
  // RosInterface makes its services while libraries of nodes are opened. Amidst an initialiser it
  // would wait for the dynamic loader, with a lock of the middleware that nodes need. What that
  // asks for is known once there is a node.
  std::future<void> types;
  if (control_ && node_) {
    types = std::async(std::launch::async, [this] {
      std::call_once(shared_.type_supports_known, [] {
        isolation::look_up_type_supports(nullptr);
        isolation::look_up_type_supports("libplay_launch_component.so");
      });
    });
  }
  const ExecutorChoice executor = choose_executor();
  auto greeting = hello(executor.threads, backend_names());
  HostChoice choice = choose_host(options_, executor, shared_.backends);
  greeting.mechanism = std::move(choice.mechanism);
  greeting.notes = std::move(choice.notes);
  if (options_.isolated && shared_.watchdog == nullptr) {
    greeting.notes.emplace_back(
        "its process has other containers, too: what poisons one ends all of them (consolidate)");
  }
  host_ = std::move(choice.host);
  if (control_ && node_ && !options_.isolated) {
    crash_watch_.emplace(
        [this](const isolation::CrashSlot& slot) { control_->on_event(own_crash(slot)); });
  }
  static std::once_flag logs_exceptions;
  std::call_once(logs_exceptions, [] {
    next_terminate_handler = std::set_terminate(on_terminate);  // the one that the host has set
  });
  manager_ = std::make_unique<ObservableComponentManager>(*host_, shared_.process);
  if (node_) {
    ros_ = std::make_unique<RosInterface>(node_, *manager_, control_.has_value());
  }
  if (types.valid()) {
    types.get();
  }
  hit(Failpoint::before_hello);
  if (control_) {
    manager_->add_sink(*control_);
    control_->open(*manager_, greeting);
  }
}

Container::~Container() = default;

ExecutorChoice Container::choose_executor() {
  const auto parameter = node_ ? node_->declare_parameter<std::int64_t>("thread_num", 0) : 0;
  if (parameter < 0 || parameter > static_cast<std::int64_t>(kMaxThreads)) {
    throw UsageError("parameter thread_num is " + std::to_string(parameter) +
                     ", expected a number from 0 to " + std::to_string(kMaxThreads) +
                     " (0: one per CPU)");
  }
  if (!options_.multi_threaded) {
    return {};
  }
  const std::size_t asked = options_.thread_num.value_or(static_cast<std::size_t>(parameter));
  const bool for_one_node = options_.isolated || options_.hosted;
  const std::size_t threads = for_one_node ? node_executor_threads(asked) : executor_threads(asked);
  return {true, threads, asked == 0};
}

play_launch_msgs::msg::ControlHello Container::hello(std::size_t threads,
                                                     std::vector<std::string> backends) const {
  play_launch_msgs::msg::ControlHello hello;
  hello.protocol_version = control::kProtocolVersion;
  hello.version = PLAY_LAUNCH_VERSION;
  hello.pid = shared_.process.pid;
  hello.start_time = shared_.process.start_time;
  hello.full_node_name = node_ ? node_->full_name() : "";
  hello.mode = options_.mode();
  hello.thread_num = static_cast<std::uint32_t>(threads);
  hello.backends = std::move(backends);
  hello.rmw_implementation = rmw_get_implementation_identifier();
  std::size_t domain_id = 0;
  if (rcl_context_get_domain_id(shared_.backends.context()->rcl(), &domain_id) == RCL_RET_OK) {
    hello.domain_id = static_cast<std::uint32_t>(domain_id);
  }
  return hello;
}

ComponentEvent Container::own_crash(const isolation::CrashSlot& slot) const {
  ComponentEvent event;
  isolation::ChildEnd end;
  end.signal = slot.report.signal;
  event.stamp.sec = static_cast<std::int32_t>(slot.report.crash_wall_time_ns / 1'000'000'000);
  event.stamp.nanosec = static_cast<std::uint32_t>(slot.report.crash_wall_time_ns % 1'000'000'000);
  event.event_type = ComponentEvent::CRASHED;
  event.full_node_name = node_->full_name();
  event.error_message = isolation::describe_end(end, slot);
  event.pid = shared_.process.pid;
  event.start_time = shared_.process.start_time;
  event.signal = slot.report.signal;
  event.backtrace = isolation::symbolise(slot, Clock::now() + kLookUpLimit);
  event.modules = isolation::modules_of(slot);
  return event;
}

Container::End Container::run() {
  while (stop_.cause() == StopCause::none) {
    stop_.wait();
  }
  stop_nodes();
  End end{exit_code(stop_.cause(), options_.hosted), true, !manager_->dead_locks().empty()};
  const bool all_gone = manager_->empty();
  if (!all_gone) {
    report_remaining();
  }
  ros_.reset();
  crash_watch_.reset();
  if (control_) {
    manager_->remove_sink(*control_);
    control_->close(Clock::now() + kFlushLimit);
  }
  node_.reset();
  if (!all_gone) {
    // What is left is used by a thread that cannot be stopped: it may not be taken apart.
    static_cast<void>(host_.release());
    static_cast<void>(manager_.release());
  }
  host_.reset();
  // A dead node may hold a lock that exit handlers, such as Fast DDS's, wait for. Only now is known
  // which could not be cleaned up: they count as gone before that.
  end.in_order = all_gone && manager_->totals().leaked == 0;
  manager_.reset();
  return end;
}

void Container::end_process_by(SteadyTime deadline, int status, const std::string& what) {
  if (shared_.watchdog != nullptr) {
    shared_.watchdog->arm(deadline, status, what);
  }
}

void Container::stop_nodes() {
  const StopCause cause = stop_.cause();
  const int asked = stop_.times_asked();
  auto limit = std::chrono::duration_cast<Clock::duration>(options_.stop_timeout);
  if (is_orphaned(cause)) {
    limit = std::min<Clock::duration>(limit, kOrphanStopLimit);
  }
  SteadyTime deadline = Clock::now() + limit;
  const std::string too_long = "taking the container apart takes too long: leaving";
  const int status = exit_code(cause, options_.hosted);
  end_process_by(deadline + kTeardownLimit, status, too_long);
  hit(Failpoint::during_stop);
  manager_->begin_stop([this] { stop_.wake(); }, stop_.why());
  host_->end_by(deadline);  // asks nodes to leave as well: those that the manager knows to leave
  while (!manager_->empty() && Clock::now() < deadline) {
    stop_.wait(deadline);
    if (stop_.times_asked() > asked) {
      deadline = std::min<SteadyTime>(deadline, Clock::now() + kSecondStopLimit);
      host_->end_by(deadline);
      end_process_by(deadline + kTeardownLimit, status, too_long);
    }
  }
}

void Container::report_remaining() const {
  for (const NodeSnapshot& snapshot : manager_->nodes()) {
    const NodeEntry& entry = snapshot.entry;
    const std::string name = entry.full_name.empty() ? "a node" : entry.full_name;
    const std::string what = !snapshot.note.empty() ? " still " + snapshot.note + ", "
                             : entry.state == NodeState::constructing
                                 ? " is still in its constructor, "
                                 : " is still in a callback or its destructor, ";
    report(name + " (" + entry.plugin_name + ", unique_id " + std::to_string(entry.unique_id) +
           ")" + what + seconds_text(std::chrono::nanoseconds(snapshot.elapsed_ns)) +
           " by now: leaving without waiting for it");
  }
}

}  // namespace play_launch::container
