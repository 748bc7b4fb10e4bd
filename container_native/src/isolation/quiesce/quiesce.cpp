#include "isolation/quiesce/quiesce.hpp"

#include <linux/futex.h>
#include <sched.h>
#include <signal.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <ctime>

#include "base/number_list.hpp"
#include "isolation/memory/protection_keys.hpp"
#include "isolation/quiesce/code_map.hpp"
#include "isolation/record/own_signals.hpp"
#include "isolation/record/survive.hpp"

namespace play_launch::isolation {
namespace {

using namespace std::chrono_literals;
using std::chrono::nanoseconds;

/// Between two looks at threads that were in a bad place. Short: in a loop that allocates, most
/// looks come at a bad moment.
constexpr nanoseconds kRetry = 100us;
/// How often to look carefully at one thread. If it was never in a place that is known to be
/// harmless, it hardly ever is: its code has no exported names, and more looks show no more.
constexpr int kCarefulLooks = 5;
/// How many times the limit to wait for threads that had no processor to be looked at on: nothing
/// is known of them, and on a loaded machine they may be in the middle of anything.
constexpr int kPatience = 4;

nanoseconds now() noexcept {
  timespec time{};
  ::clock_gettime(CLOCK_MONOTONIC, &time);
  return std::chrono::seconds(time.tv_sec) + nanoseconds(time.tv_nsec);
}

bool is_parked(const ChildRecord& child, pid_t thread) noexcept {
  const std::size_t count = std::min<std::size_t>(child.parked_count, ChildRecord::kMaxParked);
  return std::find(child.parked.begin(), child.parked.begin() + count, thread) !=
         child.parked.begin() + count;
}

constexpr const char* kOwnThreads = "/proc/self/task";

/// False also where that cannot be found out. Much quicker than the list in /proc: there is nothing
/// to unshare for the only thread of a process, and others are refused (kernel/fork.c,
/// check_unshare_flags).
bool is_only_thread() noexcept { return ::unshare(CLONE_THREAD) == 0; }

std::uint32_t count_others(NumberList& threads) noexcept {
  const pid_t self = ::gettid();
  std::uint32_t count = 0;
  const bool listed = threads.for_each([&](pid_t thread) { count += thread == self ? 0 : 1; });
  return listed ? count : 1;
}

/// Interrupts the threads that are left, and counts them.
std::uint32_t ask_to_park(ChildRecord& child, NumberList& threads) noexcept {
  const pid_t process = ::getpid();
  const pid_t self = ::gettid();
  std::uint32_t left = 0;
  const bool listed = threads.for_each([&](pid_t thread) {
    if (thread == self || is_parked(child, thread)) {
      return;
    }
    // One that is already gone is not in the list the next time.
    if (::syscall(SYS_tgkill, process, thread, park_signal()) == 0) {
      ++left;
    }
  });
  return listed ? left : 1;
}

void wait_for_change(std::atomic<std::uint32_t>& count, std::uint32_t seen) noexcept {
  static_assert(sizeof count == sizeof(std::uint32_t));
  const timespec time{0, kRetry.count()};
  ::syscall(SYS_futex, &count, FUTEX_WAIT_PRIVATE, seen, &time, nullptr, 0);
}

bool is_ending(const ChildRecord& child) noexcept { return child.ender != 0; }

/// At the calling thread, since install_park_handler() or its own beginning.
thread_local constinit int looks = 0;

extern "C" void on_park_signal(int, siginfo_t* info, void* context) {
  const int error = errno;
  ChildRecord* const child = current_child();
  if (child != nullptr && info->si_pid == ::getpid() && is_ending(*child)) {
    if (child->options.key_rights != 0) {
      assume_rights(child->options.key_rights);  // what is looked at may be the node's own memory
    }
    const CallStack stack = interrupted_call_stack(context);
    const bool first = looks++ == 0;
    const bool lenient = looks > kCarefulLooks;
    Judgement judgement{.harmless = false, .way_out = stack.count};
    survive([&] { judgement = judge(stack, lenient ? Caution::lenient : Caution::careful); });
    if (judgement.harmless) {
      child->seen_inside -= first ? 0 : 1;
      park(*child);
    }
    child->seen_inside += first ? 1 : 0;
    if (judgement.way_out < stack.count) {
      survive([&] { park_on_return_to(stack.frames[judgement.way_out]); });
    }
  }
  errno = error;
}

}  // namespace

// Not one of the real-time signals, which queue up: a thread that has to wait for a processor would
// then be looked at many times in one place. The kernel never sends this one.
int park_signal() noexcept { return SIGSTKFLT; }

void install_park_handler() noexcept {
  looks = 0;
  struct sigaction action{};
  action.sa_sigaction = on_park_signal;
  action.sa_flags = SA_SIGINFO | SA_RESTART | SA_ONSTACK;
  sigfillset(&action.sa_mask);
  ::sigaction(park_signal(), &action, nullptr);
}

void park(ChildRecord& child, bool at_rest) noexcept {
  block_all_signals();
  if (at_rest) {
    child.threads.rest();
  }
  const std::uint32_t place = child.parked_count.fetch_add(1);
  if (place < ChildRecord::kMaxParked) {
    child.parked[place] = ::gettid();
  }
  ::syscall(SYS_futex, &child.parked_count, FUTEX_WAKE_PRIVATE, 1, nullptr, nullptr, 0);
  while (true) {
    ::pause();
  }
}

void quiesce(ChildRecord& child) noexcept {
  if (is_only_thread()) {
    child.slot->report.threads_parked = child.parked_count;
    return;
  }
  NumberList threads(kOwnThreads);
  if (child.options.dies_abruptly) {
    child.slot->report.threads_not_parked = count_others(threads);
    return;
  }
  if (child.slot->phase != ChildPhase::returned) {
    survive([&] { child.program->cancel(); });
  }
  const nanoseconds begin = now();
  const nanoseconds limit = child.options.quiesce_limit;
  std::uint32_t left = 0;
  while (true) {
    const std::uint32_t seen = child.parked_count;
    left = ask_to_park(child, threads);
    const nanoseconds passed = now() - begin;
    const bool all_seen = left <= child.seen_inside;
    if (left == 0 || passed >= (all_seen ? limit : limit * kPatience)) {
      break;
    }
    wait_for_change(child.parked_count, seen);
  }
  child.slot->report.threads_parked = child.parked_count;
  child.slot->report.threads_not_parked = left;
}

void park_if_dying() noexcept {
  ChildRecord* const child = current_child();
  if (child != nullptr && child->ender != 0 && child->ender != ::gettid()) {
    park(*child);
  }
}

}  // namespace play_launch::isolation
