#include "hosts/cloned/node_program.hpp"

#include <algorithm>
#include <ctime>
#include <exception>
#include <utility>

#include "base/doorbell.hpp"
#include "base/failpoints.hpp"
#include "isolation/quiesce/quiesce.hpp"

namespace play_launch::container {
namespace {

static_assert(std::atomic<std::uint32_t>::is_always_lock_free &&
              std::atomic<ComponentExecutor*>::is_always_lock_free);

/// Statuses of a burial.
constexpr int kBuried = 0;
constexpr int kIncomplete = 1;

}  // namespace

void ExecutorHandle::open(ComponentExecutor& executor) noexcept {
  executor_ = &executor;
  if (cancelled_) {
    executor.cancel();
  }
}

void ExecutorHandle::close() noexcept {
  executor_ = nullptr;
  users_.fetch_or(kClosed);
  // Whoever is inside comes out soon: it is the container, or a handler in another thread. A user
  // that never comes out was killed there.
  constexpr int kPatience = 1000;
  constexpr timespec kMoment{0, 20'000};
  for (int i = 0; i < kPatience && users_ != kClosed; ++i) {
    ::nanosleep(&kMoment, nullptr);
  }
}

void ExecutorHandle::cancel() noexcept {
  cancelled_ = true;
  std::uint32_t users = users_;
  do {
    if ((users & kClosed) != 0) {
      return;
    }
  } while (!users_.compare_exchange_weak(users, users + 1));
  if (ComponentExecutor* const executor = executor_) {
    executor->cancel();
  }
  users_.fetch_sub(1);
}

NodeProgram::NodeProgram(const BackendList& backends, const ExecutorChoice& choice,
                         LoadRequest request, int doorbell)
    : backends_(backends), choice_(choice), request_(std::move(request)), doorbell_(doorbell) {}

NodeProgram::~NodeProgram() {
  static_cast<void>(component_.release());
  static_cast<void>(executor_.release());
}

int NodeProgram::run() {
  reach(NodeStage::constructing);
  hit(Failpoint::before_construct);
  try {
    const std::size_t backend = backends_.of_package(request_.package_name);
    partial_ = true;
    executor_ = backends_[backend].create_executor(choice_);
    executor_handle_.open(*executor_);
    component_ = backends_[backend].create(request_, &construction_);
  } catch (...) {
    isolation::park_if_dying();
    failure_ = describe_current_exception();
  }
  partial_ = false;
  if (failure_.empty()) {
    live();
  }
  take_apart();
  outcome_ = failure_.empty() ? NodeOutcome::left : NodeOutcome::failed;
  return 0;
}

void NodeProgram::live() {
  isolation::park_if_dying();
  hit(Failpoint::after_construct);
  full_name_ = component_->full_name();
  reach(NodeStage::constructed);
  if (!may_live()) {
    return;
  }
  try {
    executor_->add(*component_);
  } catch (...) {  // the constructor gave its node to an executor of its own
    failure_ = describe_current_exception();
    return;
  }
  executor_->beat_into(beat_);
  reach(NodeStage::spinning);
  executor_->spin();
  isolation::park_if_dying();
  hit(Failpoint::before_unload);
  executor_->remove(*component_);
}

bool NodeProgram::may_live() {
  verdict_.wait(Verdict::none);
  return verdict_ == Verdict::keep;
}

void NodeProgram::answer(bool keep) noexcept {
  verdict_ = keep ? Verdict::keep : Verdict::discard;
  verdict_.notify_all();
}

std::optional<std::chrono::nanoseconds> NodeProgram::silence() const {
  const std::int64_t last = beat_;
  if (last == 0 || outcome_ != NodeOutcome::none) {
    return std::nullopt;
  }
  const std::chrono::nanoseconds now = std::chrono::steady_clock::now().time_since_epoch();
  return std::max(now - std::chrono::nanoseconds(last), std::chrono::nanoseconds(0));
}

void NodeProgram::take_apart() {
  partial_ = true;
  component_.reset();
  executor_handle_.close();
  executor_.reset();
  partial_ = false;
}

void NodeProgram::crashed() noexcept { ring(doorbell_); }

void NodeProgram::reach(NodeStage stage) noexcept {
  stage_ = stage;
  ring(doorbell_);
}

int NodeBurial::run() {
  hit(Failpoint::during_burial);
  dead_.construction_.discard();
  dead_.executor_handle_.close();
  if (dead_.executor_ != nullptr) {
    dead_.executor_->abandon();
    remove_from_executor();
    dead_.component_.reset();
    dead_.executor_.reset();
  }
  return dead_.partial_ ? kIncomplete : kBuried;
}

void NodeBurial::remove_from_executor() {
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
