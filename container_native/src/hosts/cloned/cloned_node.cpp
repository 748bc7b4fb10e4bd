#include "hosts/cloned/cloned_node.hpp"

#include <signal.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <ctime>
#include <utility>
#include <vector>

#include "base/doorbell.hpp"
#include "base/executable.hpp"
#include "base/failpoints.hpp"
#include "base/process_identity.hpp"
#include "base/report.hpp"
#include "isolation/clone/inheritance.hpp"
#include "isolation/crash/symbolise.hpp"

namespace play_launch::container {
namespace {

/// For cleaning up after a dead node. Mostly of CPU time: who is killed while it waits for a
/// processor may be amidst the middleware.
constexpr std::chrono::milliseconds kBurialCpuLimit{1000};
constexpr std::chrono::milliseconds kBurialLimit{3000};
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

/// The innermost frames, for those who get no more than a text.
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
                       const ExecutorChoice& choice, LoadRequest request, int doorbell,
                       LockWatch& lock_watch, bool core_dumps)
    : IsolatedNode(unique_id, doorbell),
      process_name_(process_name(request)),
      lock_watch_(lock_watch),
      core_dumps_(core_dumps),
      program_(backends, choice, std::move(request), doorbell),
      donor_(process_name_, [this] { donate(); }, [this] { donated(); }) {}

void ClonedNode::donate() noexcept {
  if (!program_.prepare(unique_id())) {
    end_.returned = true;
    dead_ = true;
    return;
  }
  // From here on nothing may use the allocator: the child may leave it in any state.
  isolation::ChildOptions options;
  options.name = process_name_;
  options.core_dumps = core_dumps_;
  options.dies_abruptly = hit(Failpoint::abrupt_deaths);
  end_ = isolation::run_in_child(program_, slot_, options);
  if (!end_.clean()) {
    lock_watch_.begin();
  }
  dead_ = true;
  ring(doorbell());
  gave_back_ = isolation::give_back_heaps(slot_);
  if (program_.left_remains()) {
    options.name = "undertaker";
    options.dies_abruptly = false;
    options.time_limit = kBurialLimit;
    options.cpu_limit = kBurialCpuLimit;
    options.expendable = true;
    burial_end_ = isolation::run_in_child(burial_, burial_slot_, options);
  }
}

void ClonedNode::donated() noexcept {
  buried_ = true;
  ring(doorbell());
}

void ClonedNode::tell(NodeHostObserver& observer, IsolationTotals& totals) {
  // Read before the stage: what is dead by now goes no further.
  const bool buried = buried_;
  const bool dead = dead_;
  if (!backtrace_ && slot_.traced) {
    backtrace_ = isolation::symbolise(slot_);  // while the process still dies
  }
  tell_refusal();
  tell_progress(observer, program_.stage());
  if (!dead) {
    end_if_replaced();
    if (program_.ends_itself()) {
      leave();
    }
  }
  if (dead && !told_end_) {
    told_end_ = true;
    tell_end(observer, totals);
  }
  if (buried && !told_burial_) {
    told_burial_ = true;
    if (program_.outcome() == NodeOutcome::none && end_.error == 0) {
      count_burial(totals);
    }
  }
}

std::optional<std::chrono::nanoseconds> ClonedNode::silence() const {
  if (dead_) {
    return std::nullopt;
  }
  const auto silence = program_.silence();
  if (silence.value_or(kSuspicious) >= kSuspicious) {
    ring(doorbell());  // the monitor looks whether it is still there
  }
  return silence;
}

void ClonedNode::end_if_replaced() {
  if (replaced_ || told_ < NodeStage::constructing) {
    return;
  }
  const auto now = std::chrono::steady_clock::now();
  if (program_.silence().value_or(now - constructing_since_) < kSuspicious) {
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

void ClonedNode::tell_refusal() {
  if (!told_refusal_ && slot_.refused_call != nullptr) {
    told_refusal_ = true;
    report(label() + " " + isolation::describe_refusal(slot_) +
           "; the call had no effect, and further ones are not reported");
  }
}

void ClonedNode::tell_progress(NodeHostObserver& observer, NodeStage stage) {
  if (told_ < NodeStage::constructing && stage >= NodeStage::constructing) {
    told_ = NodeStage::constructing;
    constructing_since_ = std::chrono::steady_clock::now();
    clockid_t cpu_clock = CLOCK_THREAD_CPUTIME_ID;
    ::clock_getcpuclockid(slot_.pid, &cpu_clock);
    observer.on_constructing(unique_id(), {slot_.pid, slot_.start_time}, cpu_clock);
  }
  if (told_ < NodeStage::spinning && stage >= NodeStage::spinning) {
    told_ = NodeStage::spinning;
    if (!observer.on_loaded(unique_id(), program_.full_name())) {
      leave();
    }
  }
}

void ClonedNode::tell_end(NodeHostObserver& observer, IsolationTotals& totals) {
  if (end_.error != 0) {
    observer.on_load_failed(unique_id(), std::string("cannot start a process for the node: ") +
                                             std::strerror(end_.error));
    return;
  }
  const NodeOutcome outcome = program_.outcome();
  if (end_.clean() && outcome == NodeOutcome::failed) {
    observer.on_load_failed(unique_id(), program_.failure());
    return;
  }
  if (end_.clean() && outcome == NodeOutcome::left) {
    observer.on_gone(unique_id(), program_.ends_itself() ? kEndedItself : "");
    return;
  }
  ++totals.crashes;
  const bool quiesced = slot_.phase == isolation::ChildPhase::dying || outcome != NodeOutcome::none;
  if (!quiesced || slot_.report.inside || slot_.report.threads_not_parked > 0) {
    ++totals.unquiesced;
  }
  if (outcome != NodeOutcome::none) {
    ++totals.undertaken;  // by the node itself: a signal had asked it to leave
  }
  NodeDeath death = this->death();
  if (told_ < NodeStage::spinning) {
    death.reason = "died while it was constructed: " + death.reason + innermost(death.backtrace);
    observer.on_load_crashed(unique_id(), death);
  } else {
    observer.on_crashed(unique_id(), death);
  }
}

NodeDeath ClonedNode::death() {
  if (!backtrace_) {
    backtrace_ = isolation::symbolise(slot_);
  }
  NodeDeath death;
  death.exit_code = end_.exit_code;
  death.signal = end_.signal;
  death.reason = isolation::describe_end(end_, slot_);
  death.backtrace = std::move(*backtrace_);
  if (slot_.thread != 0) {
    death.when =
        std::chrono::steady_clock::time_point(std::chrono::nanoseconds(slot_.report.crash_time_ns));
  }
  return death;
}

void ClonedNode::count_burial(IsolationTotals& totals) const {
  const bool is_buried = !program_.left_remains() || burial_end_.clean();
  if (is_buried && gave_back_) {
    ++totals.undertaken;
    return;
  }
  ++totals.leaked;
  std::string why = "it died while it was being made or destroyed";
  if (is_buried) {
    why = "what the allocator keeps for its threads could not be given back";
  } else if (burial_end_.error != 0) {
    why = std::string("cannot start a process for that: ") + std::strerror(burial_end_.error);
  } else if (burial_end_.signal != 0) {
    why = isolation::describe_end(burial_end_, burial_slot_);
  }
  report("could not clean up after " + label() + ": " + why +
         "; what it held stays until the container ends");
}

std::string ClonedNode::full_name() const {
  return program_.stage() >= NodeStage::spinning ? program_.full_name() : "";
}

}  // namespace play_launch::container
