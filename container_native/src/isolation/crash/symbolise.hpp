#pragma once

#include <chrono>
#include <string>
#include <vector>

#include "isolation/record/crash_slot.hpp"

namespace play_launch::isolation {

/// One line per frame of the slot, such as "#1 demo::Talker::tick()+0x2e (libdemo.so+0x51ae)":
/// function and offset where the library has it, library and offset always. To be called in the
/// container, not on a donor, when CrashSlot::traced is set, or after the child's death. Remembers
/// what it has looked up. From `end` on it looks nothing up: frames that are left have no function.
std::vector<std::string> symbolise(const CrashSlot& slot,
                                   std::chrono::steady_clock::time_point end);

/// How long a thread on which others wait may look names up: 50 ms at once, and a tenth of all time
/// when many nodes die.
class LookUpTime {
 public:
  using Clock = std::chrono::steady_clock;

  /// When the look-up that begins now has to end.
  Clock::time_point begin(Clock::time_point now);
  void end(Clock::time_point now);

 private:
  static constexpr Clock::duration kMost = std::chrono::milliseconds(50);

  Clock::duration left_ = kMost;
  Clock::time_point since_{};  // what is left was counted then
};

/// The libraries and programs that the frames are in, each once, such as
/// "libdemo.so 4ae3b1… /opt/ros/lib/libdemo.so": name as in the frames, build id in hexadecimal
/// ("-" without one), path. Read in memory: the file may be another one by now.
std::vector<std::string> modules_of(const CrashSlot& slot);

/// "SIGSEGV (no memory at address 0x0) in thread 'executor'", "exit status 3 (exit() was called)",
/// "SIGKILL" and so on, with a remark when threads could not be quiesced. To be called after the
/// child's death.
std::string describe_end(const ChildEnd& end, const CrashSlot& slot);

/// "SIGSEGV"; "signal 77" for a number without a name.
std::string signal_name(int signal);

}  // namespace play_launch::isolation
