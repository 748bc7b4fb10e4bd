#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace play_launch::isolation {

/// One function that has not returned.
struct Frame {
  /// Where it goes on: the program counter, or a return address.
  std::uintptr_t address = 0;
  /// The stack pointer when it does; 0 for the innermost one.
  std::uintptr_t stack = 0;
  /// Where that return address is kept, if the function that returns there has kept it.
  std::uintptr_t* kept = nullptr;
};

/// The call stack of the thread that a signal interrupted, innermost first.
struct CallStack {
  static constexpr std::size_t kMaxFrames = 64;

  std::array<Frame, kMaxFrames> frames{};
  std::size_t count = 0;
  /// The registers are those for a system call that wakes other threads, made or not.
  bool wakes_others = false;
};

/// The program counter of the thread that a signal interrupted; `context` is the third argument of
/// the signal's handler. Async-signal-safe, reads no other memory.
std::uintptr_t interrupted_place(void* context) noexcept;

/// From the handler of such a signal, as far as it can be followed: where the stack is damaged, or
/// leads to code without unwind information, it ends. At least one frame. `jumped_to_no_code`: the
/// interrupted place is no code; the frames go on with its caller, if it was called.
/// Async-signal-safe once prepare_call_stack() has run.
CallStack interrupted_call_stack(void* context, bool jumped_to_no_code = false) noexcept;

/// The first call may load things. Once, before the first child.
void prepare_call_stack();

/// Makes the thread, whose call stack that is and whose signal handler calls this, park in the
/// moment when it would return to the frame of that number, 1 or more. The frame's function does
/// not run on. Does nothing where the return address is not found. `context` as above.
/// Async-signal-safe; faults when the stack is not where the frame says.
void park_on_return_to(const CallStack& stack, std::size_t number, void* context) noexcept;

}  // namespace play_launch::isolation
