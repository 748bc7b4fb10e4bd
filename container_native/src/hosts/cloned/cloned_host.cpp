#include "hosts/cloned/cloned_host.hpp"

#include <linux/futex.h>
#include <signal.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <ctime>
#include <system_error>
#include <utility>

#include "base/failpoints.hpp"
#include "base/process.hpp"
#include "base/report.hpp"
#include "base/scheduling.hpp"
#include "base/unique_fd.hpp"
#include "components/component_options.hpp"
#include "isolation/crash/crash_handler.hpp"
#include "isolation/crash/symbolise.hpp"

namespace play_launch::container {

CloneIsolatedHost::CloneIsolatedHost(BackendList backends, const ExecutorChoice& choice,
                                     bool core_dumps, std::shared_ptr<MemoryDomains> domains)
    : IsolatedHost(std::move(backends)),
      choice_(choice),
      core_dumps_(core_dumps),
      domains_(std::move(domains)) {
  // Before any library of a node is loaded: what is there now belongs to the container.
  isolation::prepare_crash_handling();
}

std::vector<std::string> CloneIsolatedHost::dead_locks() const {
  std::vector<std::string> lines = lock_watch_.dead_locks();
  for (std::string& line : hangs()) {
    lines.push_back(std::move(line));
  }
  return lines;
}

std::shared_ptr<IsolatedNode> CloneIsolatedHost::start(std::uint64_t unique_id, LoadRequest request,
                                                       NodeResources resources, int event_fd) {
  if (request.lock_memory) {
    throw LoadError("lock_memory is not for a node that shares the memory of its container");
  }
  auto domain = domains_ ? domains_->make(expected_full_name(request).value_or(request.plugin_name))
                         : nullptr;
  return std::make_shared<ClonedNode>(unique_id, *this, std::move(request), std::move(resources),
                                      event_fd, std::move(domain));
}

namespace {

constexpr std::size_t kThreadNameLength = 15;
/// After so long without a sign of its executor, a node may have replaced itself by another program
/// without our knowing.
constexpr std::chrono::seconds kSuspicious{2};
/// A take copies one message. One that lasts so long, and some time after that was seen (the
/// container may have been frozen), does not return.
constexpr std::chrono::seconds kLongestTake{10};
constexpr std::chrono::seconds kTakeConfirmed{2};
constexpr const char* kEndedItself = "the node ended itself: it shut the ROS context down";

/// For cleaning up after a dead node. Mostly of CPU time: a process that is killed while it waits
/// for a processor may be amidst the middleware.
constexpr std::chrono::milliseconds kCleanupCpuLimit{1000};
constexpr std::chrono::milliseconds kCleanupLimit{3000};
/// Until its death is reported, but no longer, the donor leaves the processor to those that report
/// it: users wait for the report, not for the cleanup. The monitor may be busy with other nodes.
constexpr std::chrono::nanoseconds kReportLimit = std::chrono::milliseconds(20);

/// What `ps` shows: the node's name, or its class's as long as that is all there is.
std::string process_name(const LoadRequest& request) {
  const std::string& name = request.node_name.empty() ? request.plugin_name : request.node_name;
  const std::size_t colon = name.rfind("::");
  return name.substr(colon == std::string::npos ? 0 : colon + 2).substr(0, kThreadNameLength);
}

/// Called by the monitor alone: the reports of all nodes come from it.
std::vector<std::string> frames_of(const isolation::CrashSlot& slot) {
  static isolation::LookUpTime time;
  auto frames = isolation::symbolise(slot, time.begin(isolation::LookUpTime::Clock::now()));
  time.end(isolation::LookUpTime::Clock::now());
  return frames;
}

/// The innermost frames, for readers that get a text only.
std::string innermost(const std::vector<std::string>& backtrace) {
  constexpr std::size_t kMost = 6;
  std::string text;
  for (std::size_t i = 0; i < std::min(backtrace.size(), kMost); ++i) {
    text += (i == 0 ? "; at " : ", ") + backtrace[i];
  }
  return text;
}

}  // namespace

ClonedNode::ClonedNode(std::uint64_t unique_id, CloneIsolatedHost& host, LoadRequest request,
                       NodeResources resources, int event_fd, std::unique_ptr<MemoryDomain> domain)
    : IsolatedNode(unique_id, event_fd),
      host_(host),
      domain_(std::move(domain)),
      resources_(std::move(resources)),
      program_(host.backends(), host.choice_, std::move(request), event_fd),
      process_name_(process_name(program_.request())),
      donor_(process_name_, [this] { live(); }, [this] { program_.reach(NodeLife::finished); }) {}

NodeLife ClonedNode::look() {
  // Before all else: of what is dead by now nothing changes below.
  const NodeLife life = program_.life();
  if (slot_.traced) {
    symbolise();  // while the process still dies
  }
  if (domain_ && !is_domain_named_ && has_any(life, NodeLife::spinning)) {
    is_domain_named_ = true;
    domain_->set_name(program_.full_name());
  }
  if (domain_ && has_any(life, NodeLife::ended | NodeLife::died)) {
    domain_->end();  // before it is reported and the next one is loaded
  }
  if (has_any(life, NodeLife::constructing) && !constructing_since_) {
    constructing_since_ = std::chrono::steady_clock::now();
  }
  if (!has_any(life, NodeLife::ended | NodeLife::died)) {
    end_if_replaced();
    if (program_.ends_itself()) {
      leave();
    }
  }
  return life;
}

std::optional<std::chrono::nanoseconds> ClonedNode::silence() const {
  if (has_any(program_.life(), NodeLife::ended | NodeLife::died)) {
    return std::nullopt;
  }
  const auto silence = program_.silence();
  if (silence.value_or(kSuspicious) >= kSuspicious) {
    notify_eventfd(event_fd());  // the monitor looks whether it is still there
  }
  return silence;
}

std::string ClonedNode::hang() {
  using Clock = std::chrono::steady_clock;
  constexpr auto kOver = NodeLife::failed | NodeLife::left | NodeLife::ended | NodeLife::died;
  const std::int64_t began = has_any(program_.life(), kOver) ? 0 : program_.oldest_take();
  const auto now = Clock::now();
  const auto lasts = now.time_since_epoch() - std::chrono::nanoseconds(began);
  if (began == 0 || lasts < kLongestTake || is_stopped(slot_.pid)) {
    suspected_take_ = 0;
    return "";
  }
  if (suspected_take_ != began) {
    suspected_take_ = began;
    suspected_since_ = now;
  }
  if (now - suspected_since_ < kTakeConfirmed) {
    return "";
  }
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(lasts).count();
  return program_.full_name() + " has been taking one message from the middleware for " +
         std::to_string(seconds) + " s";
}

void ClonedNode::end_if_replaced() {
  if (replaced_ || !constructing_since_) {
    return;
  }
  const auto now = std::chrono::steady_clock::now();
  if (program_.silence().value_or(now - *constructing_since_) < kSuspicious) {
    return;
  }
  const std::optional<std::string> other = other_program_of(slot_.pid);
  // The number may belong to another process by now.
  if (other && identity_of(slot_.pid).start_time == slot_.start_time) {
    replaced_ = true;
    // The child does not write into the slot any more: the memory is not its own now.
    const std::size_t length = std::min(other->size(), slot_.report.other_program.size() - 1);
    std::copy_n(other->data(), length, slot_.report.other_program.data());
    signal(SIGKILL);
  }
}

std::string ClonedNode::full_name() const {
  return has_any(program_.life(), NodeLife::spinning) ? program_.full_name() : "";
}

std::string ClonedNode::why_it_left() const { return program_.ends_itself() ? kEndedItself : ""; }

/// While the other node is still there, or what is known of it.
void ClonedNode::name_owner() {
  isolation::CrashReport& report = slot_.report;
  if (host_.domains_ == nullptr || report.protection_key == 0) {
    return;
  }
  const std::string owner = host_.domains_->owner_of(report.fault_address);
  const std::size_t length = std::min(owner.size(), report.memory_owner.size() - 1);
  std::copy_n(owner.data(), length, report.memory_owner.data());
}

void ClonedNode::symbolise() {
  if (!backtrace_) {
    name_owner();
    backtrace_ = frames_of(slot_);
  }
}

NodeDeath ClonedNode::death() {
  symbolise();
  const NodeLife life = program_.life();
  NodeDeath death;
  death.exit_code = end_.exit_code;
  death.signal = end_.signal;
  death.reason = isolation::describe_end(end_, slot_);
  if (!has_any(life, NodeLife::spinning)) {
    death.reason = "died while it was constructed: " + death.reason + innermost(*backtrace_);
  }
  death.backtrace = std::move(*backtrace_);
  death.modules = isolation::modules_of(slot_);
  if (slot_.thread != 0) {
    death.when =
        std::chrono::steady_clock::time_point(std::chrono::nanoseconds(slot_.report.crash_time_ns));
  }
  const bool quiesced = slot_.phase == isolation::ChildPhase::dying ||
                        has_any(life, NodeLife::failed | NodeLife::left);
  death.unquiesced = !quiesced || slot_.report.inside || slot_.report.threads_not_parked > 0;
  return death;
}

bool ClonedNode::is_cleaned_up() {
  const bool is_destroyed = !program_.left_remains() || cleanup_end_.clean();
  if (is_destroyed && gave_back_) {
    return true;
  }
  std::string why = "it died while it was being made or destroyed";
  if (is_destroyed) {
    why = "what the allocator keeps for its threads could not be given back";
  } else if (cleanup_end_.error != 0) {
    why = "cannot start a process for that: " + std::generic_category().message(cleanup_end_.error);
  } else if (cleanup_end_.signal != 0) {
    why =
        isolation::describe_end(cleanup_end_, cleanup_slot_) + innermost(frames_of(cleanup_slot_));
  }
  if (domain_) {
    domain_->keep_memory();
  }
  report("could not clean up after " + label() + ": " + why +
         "; what it held stays until the container ends");
  return false;
}

void ClonedNode::live() noexcept {
  Urgency urgency;
  do {  // it may be raised right now, by a faster thread
    urgency = host_.watch_urgency();
    assume(0, urgency);
  } while (urgency != host_.watch_urgency().load());
  if (!program_.prepare(unique_id())) {
    program_.reach(NodeLife::ended);
    return;
  }
  // From here on nothing may use the allocator: the child may leave it in any state.
  isolation::ChildOptions options;
  options.name = process_name_;
  options.core_dumps = host_.core_dumps_;
  options.urgency = resources_.urgency;
  options.resources = resources_.settings;
  options.group = &group_;
  enter_domain(options);
  options.dies_abruptly = hit(Failpoint::abrupt_deaths);
  end_ = isolation::run_in_child(program_, slot_, options);
  if (end_.pid == 0) {
    program_.fail("cannot start a process for the node: " +
                  std::generic_category().message(end_.error));
    program_.reach(NodeLife::ended);
    return;
  }
  const NodeLife how = ending(program_.life(), end_.clean());
  if (how == NodeLife::died) {
    host_.lock_watch_.begin();
  }
  program_.reach(how);
  if (how == NodeLife::died) {
    wait_for_report();
  }
  clean_up();
}

void ClonedNode::on_death_reported() {
  reported_ = 1;
  ::syscall(SYS_futex, &reported_, FUTEX_WAKE_PRIVATE, 1, nullptr, nullptr, 0);
}

void ClonedNode::wait_for_report() const noexcept {
  static_assert(sizeof reported_ == sizeof(std::uint32_t));
  const timespec limit{0, kReportLimit.count()};
  if (reported_ == 0) {
    ::syscall(SYS_futex, &reported_, FUTEX_WAIT_PRIVATE, 0, &limit, nullptr, 0);
  }
}

void ClonedNode::enter_domain(isolation::ChildOptions& options) const noexcept {
  if (domain_ != nullptr) {
    options.key_rights = domain_->rights();
    options.private_memory = &domain_->memory();
  }
}

void ClonedNode::clean_up() noexcept {
  gave_back_ = isolation::give_back_heaps(slot_);
  if (!program_.left_remains()) {
    return;
  }
  isolation::ChildOptions options;
  options.name = "cleanup";
  options.urgency = resources_.urgency;
  options.time_limit = kCleanupLimit;
  options.cpu_limit = kCleanupCpuLimit;
  options.expendable = true;
  if (domain_ != nullptr) {
    domain_->memory().begin_cleanup();
  }
  enter_domain(options);
  cleanup_end_ = isolation::run_in_child(cleanup_, cleanup_slot_, options);
}

}  // namespace play_launch::container
