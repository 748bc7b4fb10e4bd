#include "base/scheduling.hpp"

#include <sched.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <thread>
#include <tuple>

namespace play_launch {

namespace {

constexpr int kHighestPriority = 99;
constexpr int kLowestNice = -20;

bool is_real_time(int policy) { return policy == SCHED_FIFO || policy == SCHED_RR; }

/// Greater is more urgent.
std::tuple<int, int> rank(Urgency urgency) {
  if (is_real_time(urgency.policy)) {
    return {2, urgency.priority};
  }
  return {urgency.policy == SCHED_IDLE ? 0 : 1, -urgency.nice};
}

thread_local Rank* rank_of_thread = nullptr;

/// CPUs that the calling thread may run on, at least 1.
std::size_t usable_cpus() noexcept {
  cpu_set_t cpus;
  CPU_ZERO(&cpus);
  // It fails where the machine has more than fit in there.
  const std::size_t count = ::sched_getaffinity(0, sizeof cpus, &cpus) == 0
                                ? static_cast<std::size_t>(CPU_COUNT(&cpus))
                                : std::thread::hardware_concurrency();
  return std::max<std::size_t>(count, 1);
}

}  // namespace

static_assert(std::atomic<Urgency>::is_always_lock_free && kLeastUrgent.policy == SCHED_IDLE);

Urgency own_urgency() noexcept {
  sched_param parameter{};
  Urgency urgency;
  urgency.policy = static_cast<std::int16_t>(::sched_getscheduler(0) & ~SCHED_RESET_ON_FORK);
  if (::sched_getparam(0, &parameter) == 0) {
    urgency.priority = static_cast<std::int16_t>(parameter.sched_priority);
  }
  urgency.nice = ::getpriority(PRIO_PROCESS, 0);
  return urgency;
}

Urgency urgency_after(Urgency base, const std::vector<ResourceSetting>& settings) noexcept {
  for (const ResourceSetting& setting : settings) {
    if (setting.kind == ResourceSetting::Kind::nice) {
      base.nice = static_cast<std::int32_t>(setting.numbers[0]);
    } else if (setting.kind == ResourceSetting::Kind::scheduler) {
      base.policy = static_cast<std::int16_t>(setting.numbers[0]);
      base.priority = static_cast<std::int16_t>(setting.numbers[1]);
    }
  }
  return base;
}

bool is_more_urgent(Urgency left, Urgency right) noexcept { return rank(left) > rank(right); }

Urgency just_above(Urgency urgency) noexcept {
  if (is_real_time(urgency.policy)) {
    // First come, first served: nothing of the same priority takes the processor from it.
    const int above = std::min(urgency.priority + 1, kHighestPriority);
    return {SCHED_FIFO, static_cast<std::int16_t>(above), urgency.nice};
  }
  if (urgency.policy == SCHED_IDLE) {
    return {SCHED_OTHER, 0, urgency.nice};
  }
  return {SCHED_OTHER, 0, std::max(urgency.nice - 1, kLowestNice)};
}

void Rank::begin() noexcept {
  rank_of_thread = this;
  number_ = ::gettid();
}

void Rank::end() noexcept {
  rank_of_thread = nullptr;
  number_ = 0;
  while (risers_ != 0) {
    ::sched_yield();
  }
}

// A raising thread reports so before it checks whether the rank is put aside, and the thread that
// puts it aside reports that before it checks for raising threads: one of them sees the other.
void Rank::rise(Urgency urgency) noexcept {
  raised_ = urgency;
  ++risers_;
  if (const pid_t number = number_; number != 0 && !is_aside_) {
    assume(number, urgency);
  }
  --risers_;
}

void Rank::put_aside() noexcept {
  before_ = own_urgency();
  const Urgency calm{SCHED_OTHER, 0, before_.nice};
  is_aside_ = true;
  if (is_real_time(before_.policy)) {
    assume(0, calm);
  }
  while (risers_ != 0) {
    // Raised just now: the raising thread may wait for this very processor.
    assume(0, calm);
    ::sched_yield();
  }
  if (is_real_time(own_urgency().policy)) {
    assume(0, calm);
  }
}

void Rank::take_up() noexcept {
  is_aside_ = false;
  Urgency raised = kLeastUrgent;
  do {
    raised = raised_;
    const bool is_raised = is_more_urgent(raised, before_) && assume(0, raised);
    if (!is_raised && is_real_time(before_.policy)) {
      assume(0, before_);
    }
  } while (raised != raised_.load());
}

// A cloned process has the thread-local storage of its donor, whose rank is not its own.
NotRealTime::NotRealTime() noexcept
    : rank_(rank_of_thread != nullptr && rank_of_thread->number_ == ::gettid() ? *rank_of_thread
                                                                               : own_) {
  rank_.put_aside();
}

NotRealTime::~NotRealTime() { rank_.take_up(); }

bool assume(pid_t thread, Urgency urgency) noexcept {
  const int kept = errno;
  sched_param parameter{};
  parameter.sched_priority = urgency.priority;
  const bool nice = is_real_time(urgency.policy) ||
                    ::setpriority(PRIO_PROCESS, static_cast<id_t>(thread), urgency.nice) == 0;
  const bool policy = ::sched_setscheduler(thread, urgency.policy, &parameter) == 0;
  errno = kept;
  return nice && policy;
}

std::size_t executor_threads(std::size_t asked) noexcept {
  return asked != 0 ? asked : std::max<std::size_t>(2, usable_cpus());
}

std::size_t node_executor_threads(std::size_t asked) noexcept {
  constexpr std::size_t kMostByDefault = 4;
  return asked != 0 ? asked : std::min(executor_threads(0), kMostByDefault);
}

}  // namespace play_launch
