#include "hosts/cloned/cloned_host.hpp"

#include <signal.h>

#include <algorithm>
#include <utility>

#include "base/process.hpp"
#include "base/report.hpp"
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

std::shared_ptr<IsolatedNode> CloneIsolatedHost::start(std::uint64_t unique_id, LoadRequest request,
                                                       NodeResources resources, int event_fd) {
  if (request.lock_memory) {
    throw LoadError("lock_memory is not for a node that shares the memory of its container");
  }
  auto domain = domains_ ? domains_->make(expected_full_name(request).value_or(request.plugin_name))
                         : nullptr;
  return std::make_shared<ClonedNode>(unique_id, backends(), choice_, std::move(request),
                                      std::move(resources), watch_urgency(), event_fd, lock_watch_,
                                      core_dumps_, std::move(domain), domains_.get());
}

namespace {

constexpr std::size_t kThreadNameLength = 15;
/// After so long without a sign of its executor, a node may have replaced itself by another program
/// without our knowing.
constexpr std::chrono::seconds kSuspicious{2};
constexpr const char* kEndedItself = "the node ended itself: it shut the ROS context down";

/// What `ps` shows: the node's name, or its class's as long as that is all there is.
std::string process_name(const LoadRequest& request) {
  const std::string& name = request.node_name.empty() ? request.plugin_name : request.node_name;
  const std::size_t colon = name.rfind("::");
  return name.substr(colon == std::string::npos ? 0 : colon + 2).substr(0, kThreadNameLength);
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

ClonedNode::ClonedNode(std::uint64_t unique_id, const BackendList& backends,
                       const ExecutorChoice& choice, LoadRequest request, NodeResources resources,
                       const WatchUrgency& watch_urgency, int event_fd, LockWatch& lock_watch,
                       bool core_dumps, std::unique_ptr<MemoryDomain> domain,
                       const MemoryDomains* domains)
    : IsolatedNode(unique_id, event_fd),
      domains_(domains),
      domain_(std::move(domain)),
      program_(backends, choice, std::move(request), event_fd),
      donor_(unique_id, program_, process_name(program_.request()), lock_watch, core_dumps,
             std::move(resources), watch_urgency, domain_.get()) {}

NodeLife ClonedNode::look() {
  // Before all else: of what is dead by now nothing changes below.
  const NodeLife life = program_.life();
  if (donor_.slot().traced) {
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

void ClonedNode::end_if_replaced() {
  if (replaced_ || !constructing_since_) {
    return;
  }
  const auto now = std::chrono::steady_clock::now();
  if (program_.silence().value_or(now - *constructing_since_) < kSuspicious) {
    return;
  }
  isolation::CrashSlot& slot = donor_.slot();
  const std::optional<std::string> other = other_program_of(slot.pid);
  // The number may belong to another process by now.
  if (other && identity_of(slot.pid).start_time == slot.start_time) {
    replaced_ = true;
    // The child does not write into the slot any more: the memory is not its own now.
    const std::size_t length = std::min(other->size(), slot.report.other_program.size() - 1);
    std::copy_n(other->data(), length, slot.report.other_program.data());
    signal(SIGKILL);
  }
}

ProcessIdentity ClonedNode::process() const {
  return {donor_.slot().pid, donor_.slot().start_time};
}

std::string ClonedNode::full_name() const {
  return has_any(program_.life(), NodeLife::spinning) ? program_.full_name() : "";
}

std::string ClonedNode::why_it_left() const { return program_.ends_itself() ? kEndedItself : ""; }

/// While the other node is still there, or what is known of it.
void ClonedNode::name_owner() {
  isolation::CrashReport& report = donor_.slot().report;
  if (domains_ == nullptr || report.protection_key == 0) {
    return;
  }
  const std::string owner = domains_->owner_of(report.fault_address);
  const std::size_t length = std::min(owner.size(), report.memory_owner.size() - 1);
  std::copy_n(owner.data(), length, report.memory_owner.data());
}

void ClonedNode::symbolise() {
  if (!backtrace_) {
    name_owner();
    static isolation::LookUpTime time;  // of the monitor: the reports of all nodes come from it
    backtrace_ =
        isolation::symbolise(donor_.slot(), time.begin(isolation::LookUpTime::Clock::now()));
    time.end(isolation::LookUpTime::Clock::now());
  }
}

NodeDeath ClonedNode::death() {
  symbolise();
  const isolation::CrashSlot& slot = donor_.slot();
  const isolation::ChildEnd& end = donor_.end();
  const NodeLife life = program_.life();
  NodeDeath death;
  death.exit_code = end.exit_code;
  death.signal = end.signal;
  death.reason = isolation::describe_end(end, slot);
  if (!has_any(life, NodeLife::spinning)) {
    death.reason = "died while it was constructed: " + death.reason + innermost(*backtrace_);
  }
  death.backtrace = std::move(*backtrace_);
  death.modules = isolation::modules_of(slot);
  if (slot.thread != 0) {
    death.when =
        std::chrono::steady_clock::time_point(std::chrono::nanoseconds(slot.report.crash_time_ns));
  }
  const bool quiesced = slot.phase == isolation::ChildPhase::dying ||
                        has_any(life, NodeLife::failed | NodeLife::left);
  death.unquiesced = !quiesced || slot.report.inside || slot.report.threads_not_parked > 0;
  return death;
}

bool ClonedNode::is_cleaned_up() {
  const std::string remains = donor_.remains();
  if (!remains.empty()) {
    if (domain_) {
      domain_->keep_memory();
    }
    report("could not clean up after " + label() + ": " + remains +
           "; what it held stays until the container ends");
  }
  return remains.empty();
}

}  // namespace play_launch::container
