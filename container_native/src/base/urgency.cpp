#include "base/urgency.hpp"

#include <sched.h>
#include <sys/resource.h>

#include <algorithm>
#include <cerrno>
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

}  // namespace

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

NotRealTime::NotRealTime() noexcept : before_(own_urgency()) {
  if (is_real_time(before_.policy)) {
    assume(0, {SCHED_OTHER, 0, before_.nice});
  }
}

NotRealTime::~NotRealTime() {
  if (is_real_time(before_.policy)) {
    assume(0, before_);
  }
}

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

}  // namespace play_launch
