#pragma once

#include <sys/types.h>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/resource_setting.hpp"

namespace play_launch {

/// How the scheduler ranks a thread: its policy, with that a priority (1 to 99, for SCHED_FIFO and
/// SCHED_RR only), and its nice value.
struct alignas(8) Urgency {  // for atomic access without a lock, by any compiler
  std::int16_t policy = 0;   // SCHED_OTHER
  std::int16_t priority = 0;
  std::int32_t nice = 0;

  friend bool operator==(const Urgency&, const Urgency&) = default;
};

constexpr Urgency kLeastUrgent{5 /* SCHED_IDLE */, 0, 19};

/// That of the calling thread.
Urgency own_urgency() noexcept;

/// What a thread of urgency `base` has after these settings, if the kernel agrees.
Urgency urgency_after(Urgency base, const std::vector<ResourceSetting>& settings) noexcept;

/// Whether `left` gets the processor before `right`.
bool is_more_urgent(Urgency left, Urgency right) noexcept;

/// The least urgency that is more urgent; of the highest itself.
Urgency just_above(Urgency urgency) noexcept;

/// Gives it to a thread of this process, by its number, 0: the calling one; false when the kernel
/// refuses. One of SCHED_FIFO and SCHED_RR keeps its nice value, which means nothing there: a
/// process that may give it up could not take it back. Async-signal-safe, and keeps errno.
bool assume(pid_t thread, Urgency urgency) noexcept;

/// The urgency of one thread, which others may raise at any time.
class Rank {
 public:
  /// By the thread itself: from here on it can be raised.
  void begin() noexcept;
  /// By the thread itself: it is not touched any more.
  void end() noexcept;
  /// As far as the kernel agrees. Any thread.
  void rise(Urgency urgency) noexcept;

 private:
  friend class NotRealTime;

  /// By the thread itself: until take_up() it is no real-time thread, whatever others ask for.
  void put_aside() noexcept;
  void take_up() noexcept;

  std::atomic<pid_t> number_{0};  // of the thread; 0: it has not begun, or is about to end
  std::atomic<int> risers_{0};    // threads that use the number, and saw that it is not put aside
  std::atomic<bool> is_aside_{false};
  Urgency before_;                             // when it was put aside
  std::atomic<Urgency> raised_{kLeastUrgent};  // what was asked for last
};

/// As long as it lives, the calling thread is not a real-time one.
///
/// For reaping a process: the kernel then waits, without ever sleeping, for a thread that reads
/// the process's folder in /proc. Should that be a thread that the caller keeps from its processor,
/// it waits for minutes, and not even SIGKILL ends it (d_invalidate() in release_task(), Linux
/// 6.18).
class NotRealTime {
 public:
  NotRealTime() noexcept;
  ~NotRealTime();
  NotRealTime(const NotRealTime&) = delete;
  NotRealTime& operator=(const NotRealTime&) = delete;

 private:
  Rank own_;  // of a thread that is not raised
  Rank& rank_;
};

/// Threads for the executor of all nodes of a process: what was asked for, else one per usable CPU,
/// but at least 2.
std::size_t executor_threads(std::size_t asked) noexcept;

/// Threads for the executor of a single node: what was asked for, else one per usable CPU, but at
/// least 2 and at most 4.
std::size_t node_executor_threads(std::size_t asked) noexcept;

}  // namespace play_launch
