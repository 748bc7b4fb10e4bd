#include "hosts/cloned/node_program.hpp"

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <ctime>
#include <exception>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/detail/intra_process.hpp>
#include <system_error>
#include <utility>

#include "base/failpoints.hpp"
#include "base/scheduling.hpp"
#include "base/unique_fd.hpp"
#include "isolation/clone/donor_thread.hpp"
#include "isolation/crash/symbolise.hpp"
#include "isolation/quiesce/quiesce.hpp"

namespace play_launch::container {
namespace {

/// Exit statuses of a cleanup.
constexpr int kComplete = 0;
constexpr int kIncomplete = 1;

}  // namespace

NodeProgram::NodeProgram(const BackendList& backends, const ExecutorChoice& choice,
                         LoadRequest request, int event_fd)
    : backends_(backends), choice_(choice), request_(std::move(request)), event_fd_(event_fd) {}

NodeProgram::~NodeProgram() {
  static_cast<void>(component_.release());
  static_cast<void>(executor_.release());
}

bool NodeProgram::prepare(std::uint64_t unique_id) noexcept {
  try {
    found_ = backends_.find(unique_id, request_);
  } catch (...) {
    fail(describe_current_exception());
    return false;
  }
  if (stop_->is_set()) {
    life_.add(NodeLife::left);
    return false;
  }
  return true;
}

void NodeProgram::fail(std::string reason) noexcept {
  failure_ = std::move(reason);
  life_.add(NodeLife::failed);
}

int NodeProgram::run() {
  reach(NodeLife::constructing);
  hit(Failpoint::before_construct);
  try {
    partial_ = true;
    ExecutorChoice choice = choice_;
    if (choice.by_cpus) {
      choice.threads = node_executor_threads(0);  // of this process, which may have its own CPUs
    }
    executor_ = backends_[found_.backend].create_executor(choice, stop_);
    const HandleLedger::Watch watch(handles_);
    component_ = found_.component_class->create(request_);
  } catch (...) {
    isolation::park_if_dying();
    failure_ = describe_current_exception();
  }
  partial_ = false;
  if (failure_.empty()) {
    live();
  }
  take_apart();
  life_.add(failure_.empty() ? NodeLife::left : NodeLife::failed);
  return 0;
}

void NodeProgram::live() {
  isolation::park_if_dying();
  hit(Failpoint::after_construct);
  full_name_ = component_->full_name();
  try {
    executor_->add(*component_);
  } catch (...) {  // the constructor gave its node to an executor of its own
    failure_ = describe_current_exception();
    return;
  }
  executor_->beat_into(beat_);
  reach(NodeLife::spinning);
  executor_->spin();
  isolation::park_if_dying();
  hit(Failpoint::before_unload);
  executor_->remove(*component_);
}

std::optional<std::chrono::nanoseconds> NodeProgram::silence() const {
  const std::int64_t last = beat_;
  constexpr auto kOver = NodeLife::failed | NodeLife::left | NodeLife::ended | NodeLife::died;
  if (last == 0 || has_any(life(), kOver)) {
    return std::nullopt;
  }
  const std::chrono::nanoseconds now = std::chrono::steady_clock::now().time_since_epoch();
  return std::max(now - std::chrono::nanoseconds(last), std::chrono::nanoseconds(0));
}

void NodeProgram::take_apart() {
  partial_ = true;
  component_.reset();
  executor_.reset();
  partial_ = false;
}

void NodeProgram::crashed() noexcept { notify_eventfd(event_fd_); }

void NodeProgram::end_itself() noexcept {
  ends_itself_ = true;
  stop_->set();
  notify_eventfd(event_fd_);  // it leaves under the same pressure as one that is unloaded
}

void NodeProgram::reach(NodeLife part) noexcept {
  life_.add(part);
  notify_eventfd(event_fd_);
}

int NodeCleanup::run() {
  hit(Failpoint::during_cleanup);
  if (dead_.component_ == nullptr) {
    give_back_handles();
  }
  if (dead_.executor_ != nullptr) {
    dead_.executor_->abandon();
    remove_from_executor();
    dead_.component_.reset();
    dead_.executor_.reset();
  }
  return dead_.partial_ ? kIncomplete : kComplete;
}

/// Those of a constructor that was not finished, of which nothing else is known.
void NodeCleanup::give_back_handles() {
  ComponentBackend& backend = dead_.backends_[dead_.found_.backend];
  IntraProcessHub& hub = detail::ContextAccess::intra_process(*backend.context());
  dead_.handles_.for_each_node([&hub](const rcl_node_t& node) { hub.remove_all_of(node); });
  dead_.handles_.give_back(
      [&backend](const auto& function) { return backend.with_logging_lock(function); });
}

void NodeCleanup::remove_from_executor() {
  if (dead_.component_ == nullptr) {
    return;
  }
  try {
    dead_.executor_->remove(*dead_.component_);
  } catch (const std::exception&) {
    // It was not added yet.
  }
}

namespace {

/// For cleaning up after a dead node. Mostly of CPU time: a process that is killed while it waits
/// for a processor may be amidst the middleware.
constexpr std::chrono::milliseconds kCleanupCpuLimit{1000};
constexpr std::chrono::milliseconds kCleanupLimit{3000};
/// The cleanup does not depend on the report, and the monitor may be busy with other nodes.
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
  clean_up();
}

void NodeDonor::begin_cleanup() noexcept {
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

void NodeDonor::clean_up() {
  gave_back_ = isolation::give_back_heaps(slot_);
  if (program_.left_remains()) {
    isolation::ChildOptions options;
    options.name = "undertaker";
    options.urgency = resources_.urgency;
    options.time_limit = kCleanupLimit;
    options.cpu_limit = kCleanupCpuLimit;
    options.expendable = true;
    if (domain_ != nullptr) {
      domain_->memory().begin_cleanup();
      enter_domain(options);
    }
    cleanup_end_ = isolation::run_in_child(cleanup_, cleanup_slot_, options);
  }
}

std::string NodeDonor::remains() const {
  if (!program_.left_remains() || cleanup_end_.clean()) {
    return gave_back_ ? "" : "what the allocator keeps for its threads could not be given back";
  }
  if (cleanup_end_.error != 0) {
    return "cannot start a process for that: " +
           std::generic_category().message(cleanup_end_.error);
  }
  return cleanup_end_.signal != 0 ? isolation::describe_end(cleanup_end_, cleanup_slot_)
                                  : "it died while it was being made or destroyed";
}

}  // namespace play_launch::container
