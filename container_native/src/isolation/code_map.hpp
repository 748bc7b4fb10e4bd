#pragma once

#include <cstddef>
#include <cstdint>

namespace play_launch::isolation {

/// How strictly to judge a thread whose innermost frame is in the C library.
enum class Caution {
  /// It must be blocked in a system call there: a function that is running may hold one of the
  /// library's many short locks, and is soon done.
  wait_for_syscall,
  /// Wherever it is there, but for the allocator, stdio and what starts threads.
  accept_running,
};

/// Looks up the places in the C library that matter. Once, before the first child.
void prepare_code_map();

/// Whether a thread with these frames (innermost first: a program counter, then return addresses)
/// holds nothing, as far as can be seen, that others wait for. Decided by the innermost frame that
/// is neither in the C nor the C++ library: not in the middleware, an allocator or the loader, nor
/// in a template of rclcpp or of this SDK that was compiled into somebody's library. (Outer frames
/// always are the middleware's: it calls the callbacks, without holding a lock.) A thread that
/// waits for another one to end is harmless anywhere. Async-signal-safe.
bool is_harmless(const std::uintptr_t* frames, std::size_t count, Caution caution) noexcept;

/// The call stack of the thread that a signal interrupted, from its handler: `context` is the
/// handler's third argument. Gives the number of frames written, innermost first. Async-signal-safe
/// once prepare_code_map() has run.
std::size_t interrupted_frames(void* context, std::uintptr_t* frames, std::size_t size) noexcept;

}  // namespace play_launch::isolation
