#pragma once

#include <signal.h>
#include <sys/types.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace play_launch::isolation {

/// How far a child is. Only the child moves it on; after its death it tells how far it came.
enum class ChildPhase : std::uint32_t {
  none,      // did not run yet
  running,   // in its program
  leaving,   // a signal asked it to leave
  crashed,   // a fault was caught, its threads are being quiesced
  exiting,   // something in it called exit(), its threads are being quiesced
  dying,     // quiesced; what follows is its end
  returned,  // its program returned
};

/// How a child ended, as its signal handlers and exit() saw it. Plain: a child may be killed amidst
/// writing it.
struct CrashReport {
  static constexpr std::size_t kMaxFrames = 64;

  // A fault, an abort(), or a signal that the child did not obey in time; see CrashSlot::thread.
  std::array<char, 16> thread_name{};
  std::uint64_t crash_time_ns = 0;       // CLOCK_MONOTONIC
  std::uint64_t crash_wall_time_ns = 0;  // CLOCK_REALTIME
  int signal = 0;
  int code = 0;      // si_code
  pid_t sender = 0;  // si_pid, when the signal was sent and not caused by an instruction; else 0
  std::uintptr_t fault_address = 0;  // si_addr, when it was caused by an instruction
  /// Of the memory at that address, when that is why it was refused (SEGV_PKUERR); else 0.
  int protection_key = 0;
  std::uintptr_t program_counter = 0;
  /// Innermost first: the program counter, then return addresses. There is at least the former.
  std::array<std::uintptr_t, kMaxFrames> frames{};
  std::uint32_t frame_count = 0;

  /// An uncaught exception: its type, and what().
  std::array<char, 128> exception_type{};
  std::array<char, 256> exception_text{};
  /// Which of the frames threw it, or threw it on; 0: that is not known, or there is no exception.
  std::size_t thrower = 0;

  // What quiescing came to, for crashes and for exit().
  /// The thread that crashed, or called exit(), was itself inside the middleware or the allocator,
  /// and may have taken a lock with it.
  bool inside = false;
  std::uint32_t threads_parked = 0;      // brought to a harmless place, or ended by themselves
  std::uint32_t threads_not_parked = 0;  // killed wherever they were

  /// After the death: the thread pointers of threads, but for the first, that were at rest by then.
  std::array<std::uintptr_t, kMaxFrames> resting_threads{};
  std::uint32_t resting_thread_count = 0;

  /// Its required control group did not let it in, and it ended.
  bool kept_out = false;

  // The child called something that ended it.
  const char* end_call = nullptr;  // what, such as "exit()"; null: nothing of the kind
  int exit_status = 0;

  /// The program that runs in the place of the child, which replaced itself (execve).
  std::array<char, 256> other_program{};

  /// The full name of the node whose private memory is at the fault's address.
  std::array<char, 256> memory_owner{};
};

/// What a child reports about itself: written by the child and by its signal handlers, read by the
/// container. Lives in ordinary memory of the container, as the child shares it. Holds nothing that
/// must be destroyed.
struct CrashSlot {
  // Set by the child before anything else, pid first.
  std::atomic<pid_t> pid{0};
  std::atomic<std::uint64_t> start_time{0};  // clock ticks after boot, /proc/<pid>/stat field 22
  std::atomic<bool> alive{false};            // from then until just before the pid is free again
  std::atomic<int> senders{0};               // see send_signal()
  std::atomic<ChildPhase> phase{ChildPhase::none};

  // A signal asked the child to leave.
  std::atomic<int> stop_signal{0};
  std::atomic<pid_t> stop_sender{0};

  /// The signal that the child ends itself by, also where SIGKILL does it in place of that.
  std::atomic<int> died_of{0};

  /// The thread that crashed; 0: no crash was caught. Signal, place and first frame are in the
  /// report by then, the other frames and `inside` when `traced` is set.
  std::atomic<pid_t> thread{0};
  std::atomic<bool> traced{false};

  /// Whole when the child is dead.
  CrashReport report;
};

/// The fault is that the program counter points to no code.
inline bool is_jump_to_no_code(const CrashReport& report) {
  return (report.signal == SIGSEGV || report.signal == SIGBUS) && report.code > 0 &&
         report.fault_address == report.program_counter;
}

/// How a child ended.
struct ChildEnd {
  int error = 0;      // errno when there was no child at all; the rest is 0 then
  pid_t pid = 0;      // what it had; free to be used again by now
  int exit_code = 0;  // when it exited
  int signal = 0;     // when a signal ended it, see CrashSlot::died_of; else 0
  bool dumped_core = false;
  /// Its entry function came to its end, whatever the child then died of: its first thread did not
  /// die amidst something.
  bool returned = false;

  bool clean() const { return error == 0 && returned && signal == 0 && exit_code == 0; }
};

}  // namespace play_launch::isolation
