#include "container/isolated_node.hpp"

#include <signal.h>
#include <sys/pidfd.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <utility>

#include "container/doorbell.hpp"
#include "container/process_identity.hpp"
#include "container/report.hpp"
#include "control/unique_fd.hpp"
#include "isolation/symbolise.hpp"

namespace play_launch::container {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// From asking a node to leave to SIGTERM, which makes it leave in order if it can.
constexpr auto kPatience = 1s;
/// From then to SIGKILL, which may leave a lock behind.
constexpr auto kLastPatience = 2s;
/// For cleaning up after a dead node.
constexpr auto kBurialLimit = 1000ms;

constexpr std::size_t kThreadNameLength = 15;

/// What `ps` shows: the node's name, or its class's as long as that is all there is.
std::string process_name(const LoadRequest& request) {
  const std::string& name = request.node_name.empty() ? request.plugin_name : request.node_name;
  const std::size_t colon = name.rfind("::");
  return name.substr(colon == std::string::npos ? 0 : colon + 2).substr(0, kThreadNameLength);
}

}  // namespace

IsolatedNode::IsolatedNode(std::uint64_t unique_id, const BackendList& backends,
                           const ExecutorChoice& choice, LoadRequest request, int doorbell)
    : unique_id_(unique_id),
      doorbell_(doorbell),
      process_name_(process_name(request)),
      program_(backends, choice, std::move(request), doorbell),
      donor_(process_name_, [this] { donate(); }) {}

void IsolatedNode::leave() noexcept {
  leaving_ = true;
  ring(doorbell_);
}

// Nothing here may use the allocator: the child may have left it in any state.
void IsolatedNode::donate() noexcept {
  isolation::ChildOptions options;
  options.name = process_name_;
  end_ = isolation::run_in_child(program_, slot_, options);
  dead_ = true;
  ring(doorbell_);
  if (program_.left_remains()) {
    options.name = "undertaker";
    options.time_limit = kBurialLimit;
    burial_end_ = isolation::run_in_child(burial_, burial_slot_, options);
  }
  finished_ = true;
  ring(doorbell_);
}

void IsolatedNode::tell(NodeHostObserver& observer, IsolationTotals& totals) {
  // Read before the stage: a node that is dead now goes no further.
  const bool finished = finished_;
  const bool dead = dead_;
  const NodeStage stage = program_.stage();
  if (told_ < NodeStage::constructing && stage >= NodeStage::constructing) {
    told_ = NodeStage::constructing;
    clockid_t cpu_clock = CLOCK_THREAD_CPUTIME_ID;
    ::clock_getcpuclockid(slot_.pid, &cpu_clock);
    observer.on_constructing(unique_id_, {slot_.pid, slot_.start_time}, cpu_clock);
  }
  if (told_ < NodeStage::constructed && stage >= NodeStage::constructed) {
    told_ = NodeStage::constructed;
    const bool keep = observer.on_constructed(unique_id_, program_.full_name());
    if (!keep) {
      leaving_ = true;  // its destructor has no more time than in an unloading
    }
    program_.answer(keep);
  }
  if (told_ < NodeStage::spinning && stage >= NodeStage::spinning) {
    told_ = NodeStage::spinning;
    observer.on_loaded(unique_id_);
  }
  if (dead && !told_end_) {
    told_end_ = true;
    tell_end(observer, totals);
  }
  if (finished && !told_burial_) {
    told_burial_ = true;
    if (program_.outcome() == NodeOutcome::none && end_.error == 0) {
      count_burial(totals);
    }
  }
}

void IsolatedNode::tell_end(NodeHostObserver& observer, IsolationTotals& totals) {
  if (end_.error != 0) {
    observer.on_load_failed(unique_id_, std::string("cannot start a process for the node: ") +
                                            std::strerror(end_.error));
    return;
  }
  if (end_.clean() && program_.outcome() == NodeOutcome::failed) {
    observer.on_load_failed(unique_id_, program_.failure());
    return;
  }
  if (end_.clean() && program_.outcome() == NodeOutcome::left) {
    observer.on_gone(unique_id_);
    return;
  }
  ++totals.crashes;
  const bool quiesced =
      slot_.thread != 0 || slot_.exit_called || program_.outcome() != NodeOutcome::none;
  if (!quiesced || slot_.inside || slot_.threads_not_parked > 0) {
    ++totals.unquiesced;
  }
  if (program_.outcome() != NodeOutcome::none) {
    ++totals.undertaken;  // by itself: a signal had asked it to leave
  }
  if (told_ < NodeStage::spinning) {
    observer.on_load_crashed(unique_id_, death());
  } else {
    observer.on_crashed(unique_id_, death());
  }
}

NodeDeath IsolatedNode::death() const {
  NodeDeath death;
  death.exit_code = end_.exit_code;
  death.signal = end_.signal;
  death.reason = isolation::describe_end(end_, slot_);
  death.backtrace = isolation::symbolise(slot_);
  if (slot_.thread != 0) {
    death.when = Clock::time_point(std::chrono::nanoseconds(slot_.crash_time_ns));
  }
  return death;
}

void IsolatedNode::count_burial(IsolationTotals& totals) {
  if (!program_.left_remains() || burial_end_.clean()) {
    ++totals.undertaken;
    return;
  }
  ++totals.leaked;
  std::string why = "only part of it was there";
  if (burial_end_.error != 0) {
    why = std::string("cannot start a process for that: ") + std::strerror(burial_end_.error);
  } else if (burial_end_.signal != 0) {
    why = isolation::describe_end(burial_end_, burial_slot_);
  }
  report("could not clean up after " + label() + ": " + why +
         "; what it held stays until the container ends");
}

std::string IsolatedNode::label() const {
  const std::string& name = program_.stage() >= NodeStage::constructed
                                ? program_.full_name()
                                : program_.request().node_name;
  return (name.empty() ? "a node" : name) + " (" + program_.request().plugin_name + ", unique_id " +
         std::to_string(unique_id_) + ")";
}

IsolatedNode::Time IsolatedNode::press(Time now, Time end) {
  if (dead_) {
    return Time::max();
  }
  if (leaving_ && leaving_since_ == Time::max()) {
    leaving_since_ = now;
  }
  if (leaving_since_ == Time::max() && end != Time::max()) {
    leaving_since_ = now;  // it still constructs
  }
  if (leaving_since_ == Time::max()) {
    return Time::max();
  }
  Time terminate = leaving_since_ + kPatience;
  Time kill = terminate + kLastPatience;
  if (end != Time::max()) {
    const Clock::duration whole = std::max(end - leaving_since_, Clock::duration::zero());
    terminate = std::min(terminate, leaving_since_ + whole / 2);
    kill = std::min(kill, leaving_since_ + whole * 4 / 5);
  }
  if (pressure_ < Pressure::cancelled) {
    pressure_ = Pressure::cancelled;
    program_.cancel();
  }
  if (pressure_ < Pressure::terminated && now >= terminate) {
    pressure_ = Pressure::terminated;
    report(label() + " does not leave: sending SIGTERM to process " + std::to_string(slot_.pid));
    signal(SIGTERM);
  }
  if (pressure_ < Pressure::killed && now >= kill) {
    pressure_ = Pressure::killed;
    report(label() + " still does not leave: killing process " + std::to_string(slot_.pid));
    signal(SIGKILL);
  }
  return pressure_ < Pressure::terminated ? terminate
         : pressure_ < Pressure::killed   ? kill
                                          : Time::max();
}

void IsolatedNode::signal(int number) const {
  const pid_t pid = slot_.pid;
  if (pid == 0) {
    return;
  }
  // The child may be dead and its pid be another's by now; a descriptor that was compared with the
  // start time cannot change its meaning any more.
  const control::UniqueFd process(static_cast<int>(::syscall(SYS_pidfd_open, pid, 0)));
  if (process && !dead_ && identity_of(pid).start_time == slot_.start_time) {
    ::syscall(SYS_pidfd_send_signal, process.get(), number, nullptr, 0);
  }
}

}  // namespace play_launch::container
