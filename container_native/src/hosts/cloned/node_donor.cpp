#include "hosts/cloned/node_donor.hpp"

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <chrono>
#include <ctime>
#include <system_error>
#include <utility>

#include "base/failpoints.hpp"
#include "isolation/clone/inheritance.hpp"
#include "isolation/crash/symbolise.hpp"

namespace play_launch::container {
namespace {

/// For cleaning up after a dead node. Mostly of CPU time: a process that is killed while it waits
/// for a processor may be amidst the middleware.
constexpr std::chrono::milliseconds kBurialCpuLimit{1000};
constexpr std::chrono::milliseconds kBurialLimit{3000};
/// The burial does not depend on the report, and the monitor may be busy with other nodes.
constexpr std::chrono::nanoseconds kReportLimit = std::chrono::milliseconds(20);

std::string no_process(int error) {
  return "cannot start a process for the node: " + std::generic_category().message(error);
}

}  // namespace

NodeDonor::NodeDonor(std::uint64_t unique_id, NodeProgram& program, std::string process_name,
                     LockWatch& lock_watch, bool core_dumps, NodeResources resources,
                     const WatchUrgency& watch_urgency, const MemoryDomain* domain)
    : unique_id_(unique_id),
      program_(program),
      process_name_(std::move(process_name)),
      lock_watch_(lock_watch),
      core_dumps_(core_dumps),
      resources_(std::move(resources)),
      watch_urgency_(watch_urgency),
      domain_(domain),
      thread_(process_name_, [this] { donate(); }, [this] { donated(); }) {}

void NodeDonor::donate() noexcept {
  Urgency urgency;
  do {  // it may be raised right now, by a faster thread
    urgency = watch_urgency_;
    assume(0, urgency);
  } while (urgency != watch_urgency_.load());
  if (!program_.prepare(unique_id_)) {
    program_.reach(NodeLife::ended);
    return;
  }
  // From here on nothing may use the allocator: the child may leave it in any state.
  isolation::ChildOptions options;
  options.name = process_name_;
  options.core_dumps = core_dumps_;
  options.urgency = resources_.urgency;
  options.resources = resources_.settings;
  options.group = &group_;
  enter_domain(options);
  options.dies_abruptly = hit(Failpoint::abrupt_deaths);
  end_ = isolation::run_in_child(program_, slot_, options);
  if (end_.pid == 0) {
    program_.fail(no_process(end_.error));
    program_.reach(NodeLife::ended);
    return;
  }
  const NodeLife how = ending(program_.life(), end_.clean());
  program_.reach(how);
  if (how == NodeLife::died) {
    lock_watch_.begin();
    wait_for_report();
  }
  bury();
}

void NodeDonor::begin_burial() noexcept {
  reported_ = 1;
  ::syscall(SYS_futex, &reported_, FUTEX_WAKE_PRIVATE, 1, nullptr, nullptr, 0);
}

void NodeDonor::wait_for_report() const noexcept {
  static_assert(sizeof reported_ == sizeof(std::uint32_t));
  const timespec limit{0, kReportLimit.count()};
  if (reported_ == 0) {
    ::syscall(SYS_futex, &reported_, FUTEX_WAIT_PRIVATE, 0, &limit, nullptr, 0);
  }
}

void NodeDonor::enter_domain(isolation::ChildOptions& options) const noexcept {
  if (domain_ != nullptr) {
    options.key_rights = domain_->rights();
    options.private_memory = &domain_->memory();
  }
}

void NodeDonor::bury() {
  gave_back_ = isolation::give_back_heaps(slot_);
  if (program_.left_remains()) {
    isolation::ChildOptions options;
    options.name = "undertaker";
    options.urgency = resources_.urgency;
    options.time_limit = kBurialLimit;
    options.cpu_limit = kBurialCpuLimit;
    options.expendable = true;
    if (domain_ != nullptr) {
      domain_->memory().begin_burial();
      enter_domain(options);
    }
    burial_end_ = isolation::run_in_child(burial_, burial_slot_, options);
  }
}

std::string NodeDonor::remains() const {
  if (!program_.left_remains() || burial_end_.clean()) {
    return gave_back_ ? "" : "what the allocator keeps for its threads could not be given back";
  }
  if (burial_end_.error != 0) {
    return "cannot start a process for that: " + std::generic_category().message(burial_end_.error);
  }
  return burial_end_.signal != 0 ? isolation::describe_end(burial_end_, burial_slot_)
                                 : "it died while it was being made or destroyed";
}

}  // namespace play_launch::container
