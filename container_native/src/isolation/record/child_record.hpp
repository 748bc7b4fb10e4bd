#pragma once

#include <pthread.h>
#include <sys/types.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory_resource>
#include <optional>
#include <span>
#include <string_view>

#include "base/resource_setting.hpp"
#include "base/scheduling.hpp"
#include "base/unique_fd.hpp"
#include "isolation/record/child_threads.hpp"
#include "isolation/record/crash_slot.hpp"

namespace play_launch {
class HandleLedger;
}

namespace play_launch::isolation {

/// What a child does.
class ChildProgram {
 public:
  virtual ~ChildProgram() = default;

  /// In the child, in its first thread. What it returns becomes the exit status, unless a signal
  /// asked the child to leave: then it dies of that signal. What it throws ends the child.
  /// slot.pid and slot.start_time are set, signal handlers are installed, no signal is blocked.
  virtual int run() = 0;

  /// Makes run() return soon. Called in the child from a signal handler, in any of its threads, at
  /// any time from before run() begins until after it returned, possibly more than once and in
  /// several threads at once: async-signal-safe functions only, on nothing that run() destroys.
  /// After a fault it is called as well, so that threads which run callbacks end; then run() must
  /// call park_if_dying() wherever such a thread comes out.
  virtual void cancel() noexcept = 0;

  /// Called in a signal handler of the child when the slot reports its crash (CrashSlot::traced is
  /// set), some time before the death: looking up the backtrace can begin.
  virtual void crashed() noexcept {}

  /// Called in the child, in any of its threads, when its code asks for the end of more than the
  /// child: the child alone is to end, in order.
  virtual void end_itself() noexcept {}

  /// Where to enter what the child takes from ROS's middleware; null: nowhere. Called in the child,
  /// in any of its threads.
  virtual HandleLedger* handles() noexcept { return nullptr; }
};

struct ChildOptions {
  /// What `ps` and `top` show; cut after 15 bytes.
  std::string_view name = "node";
  /// After so long it dies of SIGALRM, after so much CPU time of all its threads of SIGXCPU, as of
  /// a fault: its report says where it was. Zero: no limit.
  std::chrono::milliseconds time_limit{0};
  std::chrono::milliseconds cpu_limit{0};
  /// From a signal that asks the child to leave (SIGTERM, SIGINT, or any crash signal that another
  /// process sent) to its death of that signal, should run() not return.
  std::chrono::milliseconds leave_limit{1000};
  /// For bringing the other threads to a harmless place before the child dies of a fault; up to
  /// twenty times as long when some of them get too little of a processor.
  std::chrono::milliseconds quiesce_limit{50};
  /// Every signal that it handles ends it at once, with its other threads wherever they are. For
  /// measuring what the care above is worth.
  bool dies_abruptly = false;
  /// A core is dumped when it crashes, see set_core_dumps().
  bool core_dumps = false;
  /// How urgently it runs, whatever its donor does; nothing: as its donor.
  std::optional<Urgency> urgency = std::nullopt;
  /// What else it asks of the kernel for itself, before run(). Must outlive the child.
  std::span<const ResourceSetting> resources = {};
  /// The control group that it is born in, which is one of the resources; closed as soon as it is
  /// there. Null, or none: it enters unaided. Must outlive the child.
  UniqueFd* group = nullptr;
  /// What it may do with memory that has protection keys, see isolation/memory/; 0: it has what its
  /// donor has. Also in its signal handlers, as far as they are ours.
  std::uint32_t key_rights = 0;
  /// What play_launch::private_memory() is in it; null: ordinary memory.
  std::pmr::memory_resource* private_memory = nullptr;
  /// It may hang until its time limit: living_children() leaves it out.
  bool expendable = false;
};

/// At most so many children live at a time; more of them fail with EAGAIN.
inline constexpr std::size_t kMaxChildren = 1024;

/// A living child, as its own signal handlers see it.
struct ChildRecord {
  /// More threads than that are counted, but asked again each time.
  static constexpr std::size_t kMaxParked = 512;

  /// The child's pid in the table where current_child() looks; 0 before it began, and once dead.
  std::atomic<pid_t>* registered_pid = nullptr;
  ChildProgram* program = nullptr;
  CrashSlot* slot = nullptr;
  ChildOptions options;
  /// As the C library knows it: the donor.
  pthread_t first_thread{};
  /// A child before it on the same donor did not return: this one cleans up after it.
  bool after_death = false;
  /// The thread that ends the child: the first to crash, to call exit() or to return from run().
  std::atomic<pid_t> ender{0};
  /// How many threads were in a bad place however often they were asked to park.
  std::atomic<std::uint32_t> seen_inside{0};
  /// How long it took at most to judge where a thread is.
  std::atomic<std::chrono::nanoseconds> longest_look{};
  /// Threads that were parked, in order of arrival.
  std::array<std::atomic<pid_t>, kMaxParked> parked{};
  std::atomic<std::uint32_t> parked_count{0};
  ChildThreads threads;
  Initialisations initialisations;
};

/// The child that calls this, in any of its threads; null in the container itself and in processes
/// that were forked. Async-signal-safe.
ChildRecord* current_child() noexcept;

/// One place in the table by which a process finds its own record. Async-signal-safe.
class Registration {
 public:
  /// On the donor, before the child exists. The record must stay where it is.
  explicit Registration(ChildRecord& record) noexcept;
  ~Registration();
  Registration(const Registration&) = delete;
  Registration& operator=(const Registration&) = delete;

  /// False: kMaxChildren live already.
  explicit operator bool() const { return index_ < kMaxChildren; }

 private:
  std::size_t index_ = 0;
};

/// Writes the ids of the children that live now, but for expendable ones, into `pids`; their
/// number. Any thread.
std::size_t living_children(std::array<pid_t, kMaxChildren>& pids) noexcept;

}  // namespace play_launch::isolation
