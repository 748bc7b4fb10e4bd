#include "isolation/quiesce/quiesce.hpp"

#include <fcntl.h>
#include <linux/futex.h>
#include <sched.h>
#include <signal.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <ctime>
#include <string_view>

#include "base/process.hpp"
#include "isolation/memory/protection_keys.hpp"
#include "isolation/quiesce/code_map.hpp"
#include "isolation/record/own_signals.hpp"

namespace play_launch::isolation {
namespace {

using namespace std::chrono_literals;
using std::chrono::nanoseconds;

/// Not one of the real-time signals, which queue up: a thread that has to wait for a processor
/// would then be looked at many times in one place. The kernel never sends this one.
constexpr int kParkSignal = SIGSTKFLT;
/// Between two looks at threads that were in a bad place. Short: in a loop that allocates, most
/// looks come at a bad moment.
constexpr nanoseconds kRetry = 100us;
/// How many times the longest look to wait at least: a thread that is looked at all the time never
/// leaves its place. Unwinding takes 100 ms where a processor is emulated.
constexpr int kLooksBetween = 2;
/// How often to look at a thread before it counts as one that stays in a bad place.
constexpr int kLeastLooks = 8;
/// How often to look carefully at one thread. If it was never in a place that is known to be
/// harmless, it hardly ever is: its code has no exported names, and more looks show no more.
constexpr int kCarefulLooks = 5;
/// How many times the limit to wait for threads that were not looked at so often because processors
/// are short or slow: nothing is known of them, they may be in the middle of anything.
constexpr int kTerminateAfter = 20;

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

using Text = std::array<char, 4096>;

/// What /proc says of a thread; empty when it cannot be read.
std::string_view read_about(const NumberList& threads, pid_t thread, std::string_view file,
                            Text& text) noexcept {
  constexpr std::size_t kDigits = 10;
  std::array<char, 32> path{};
  char* end = std::to_chars(path.data(), path.data() + kDigits, thread).ptr;
  *end++ = '/';
  std::copy(file.begin(), file.end(), end);
  const int fd = ::openat(threads.descriptor(), path.data(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) {
    return {};
  }
  const ssize_t size = ::read(fd, text.data(), text.size());
  ::close(fd);
  return {text.data(), static_cast<std::size_t>(std::max<ssize_t>(size, 0))};
}

/// Of a thread that blocks the park signal, as do helpers of libraries which leave signals to
/// others (ZeroMQ's, GLib's): it sleeps in a system call in which threads rarely hold anything. Its
/// stack is not looked at.
bool sleeps_unasked(const NumberList& threads, pid_t thread) noexcept {
  constexpr std::array<long, 6> kMayHold{SYS_futex,  SYS_write,   SYS_writev,
                                         SYS_sendto, SYS_sendmsg, SYS_sendmmsg};
  constexpr std::string_view kBlocked = "\nSigBlk:\t";
  constexpr int kHexadecimal = 16;
  Text text;
  // "running" for one that does not sleep, and -1 for one that sleeps elsewhere.
  long call = -1;
  const std::string_view sleep = read_about(threads, thread, "syscall", text);
  std::from_chars(sleep.data(), sleep.data() + sleep.size(), call);
  if (call < 0 || std::ranges::find(kMayHold, call) != kMayHold.end()) {
    return false;
  }
  const std::string_view status = read_about(threads, thread, "status", text);
  const std::size_t place = status.find(kBlocked);
  // Not one that waits for the memory map, as the allocator does: that is state D.
  if (place == status.npos || status.find("\nState:\tS") == status.npos) {
    return false;
  }
  std::uint64_t blocked = 0;
  std::from_chars(status.data() + place + kBlocked.size(), status.data() + status.size(), blocked,
                  kHexadecimal);
  return (blocked >> (kParkSignal - 1) & 1) != 0;
}

struct Others {
  std::uint32_t left = 0;
  std::uint32_t unasked = 0;  // see sleeps_unasked()
};

/// Interrupts the threads that are left, and counts them.
Others ask_to_park(ChildRecord& child, NumberList& threads) noexcept {
  const pid_t process = ::getpid();
  const pid_t self = ::gettid();
  Others others;
  const bool listed = threads.for_each([&](pid_t thread) {
    // One that is already gone is not in the list the next time.
    if (thread == self || is_parked(child, thread) ||
        ::syscall(SYS_tgkill, process, thread, kParkSignal) != 0) {
      return;
    }
    // Parked threads block all signals, too: it may have become one meanwhile.
    if (sleeps_unasked(threads, thread) && !is_parked(child, thread)) {
      ++others.unasked;
    } else {
      ++others.left;
    }
  });
  return listed ? others : Others{.left = 1};
}

void wait_for_change(std::atomic<std::uint32_t>& count, std::uint32_t seen,
                     nanoseconds longest) noexcept {
  static_assert(sizeof count == sizeof(std::uint32_t));
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(longest);
  const timespec time{seconds.count(), (longest - seconds).count()};
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
    const nanoseconds begin = now();
    const CallStack stack = interrupted_call_stack(context);
    child->seen_inside += ++looks == kLeastLooks ? 1 : 0;
    const bool lenient = looks > kCarefulLooks;
    Judgement judgement{.harmless = false, .way_out = stack.count};
    survive([&] { judgement = judge(stack, lenient ? Caution::lenient : Caution::careful); });
    if (judgement.harmless) {
      park(*child);
    }
    if (judgement.way_out < stack.count) {
      survive([&] { park_on_return_to(stack, judgement.way_out, context); });
    }
    child->longest_look = std::max(child->longest_look.load(), now() - begin);
  }
  errno = error;
}

}  // namespace

void install_park_handler() noexcept {
  looks = 0;
  struct sigaction action{};
  action.sa_sigaction = on_park_signal;
  action.sa_flags = SA_SIGINFO | SA_RESTART | SA_ONSTACK;
  sigfillset(&action.sa_mask);
  ::sigaction(kParkSignal, &action, nullptr);
}

void park(ChildRecord& child, bool at_rest) noexcept {
  block_all_signals();
  if (at_rest) {
    child.threads.rest();
  }
  child.seen_inside -= looks >= kLeastLooks ? 1 : 0;
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
  Others others;
  while (true) {
    const std::uint32_t seen = child.parked_count;
    others = ask_to_park(child, threads);
    const nanoseconds passed = now() - begin;
    const bool all_seen = others.left <= child.seen_inside;
    if (others.left == 0 || passed >= (all_seen ? limit : limit * kTerminateAfter)) {
      break;
    }
    const nanoseconds between =
        std::min(child.longest_look.load() * kLooksBetween, limit * kTerminateAfter / kLeastLooks);
    wait_for_change(child.parked_count, seen, std::max(kRetry, between));
  }
  child.slot->report.threads_parked = child.parked_count + others.unasked;
  child.slot->report.threads_not_parked = others.left;
}

void park_if_dying() noexcept {
  ChildRecord* const child = current_child();
  if (child != nullptr && child->ender != 0 && child->ender != ::gettid()) {
    park(*child);
  }
}

}  // namespace play_launch::isolation
