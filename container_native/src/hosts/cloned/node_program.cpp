#include "hosts/cloned/node_program.hpp"

#include <algorithm>
#include <chrono>
#include <exception>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/detail/intra_process.hpp>
#include <utility>

#include "base/failpoints.hpp"
#include "base/scheduling.hpp"
#include "base/unique_fd.hpp"
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
  const std::int64_t last = beat_.last;
  constexpr auto kOver = NodeLife::failed | NodeLife::left | NodeLife::ended | NodeLife::died;
  if (last == 0 || has_any(life(), kOver)) {
    return std::nullopt;
  }
  const std::chrono::nanoseconds now = std::chrono::steady_clock::now().time_since_epoch();
  return std::max(now - std::chrono::nanoseconds(last), std::chrono::nanoseconds(0));
}

std::int64_t NodeProgram::oldest_take() const {
  std::int64_t oldest = 0;
  for (const std::atomic<std::int64_t>& place : beat_.takes) {
    const std::int64_t began = place.load(std::memory_order_relaxed);
    oldest = began == 0 || (oldest != 0 && oldest < began) ? oldest : began;
  }
  return oldest;
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

}  // namespace play_launch::container
