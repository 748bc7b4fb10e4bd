#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "isolation/quiesce/call_stack.hpp"

namespace play_launch::isolation {

/// How to judge a thread of which too little can be seen: one that runs in the C library, where a
/// function may hold one of many short locks, and one in a function without an exported name.
enum class Caution {
  careful,  // check again, it is soon done; the caller decides
  lenient,  // take it as harmless, but for the allocator, stdio and what starts threads
};

struct Judgement {
  /// The thread holds nothing, as far as can be seen, that others wait for.
  bool harmless = true;
  /// If it is not: the first frame where it would be; the number of frames without one.
  std::size_t way_out = 0;
};

/// Notes which libraries are there: the client library, the middleware, the allocator and what they
/// need. What comes later belongs to nodes. And looks up the places in the C library that matter.
/// Once, in the container, before the first library of a node is loaded. Takes the loader's lock.
void prepare_code_map();

/// Looks those places up; the names of the ones that are missing, or not what they are expected to
/// be, as another C library may have it: judge() goes by the caller there.
std::vector<std::string> find_landmarks();

/// Decided by the innermost frame that is neither in the C nor the C++ library: whether it is in a
/// library that was there before the first node, which has locks that all
/// nodes share; in a message library; or in a template of rclcpp or of this SDK that was compiled
/// into a user's library. (Outer frames always are the middleware's: it calls the
/// callbacks, without holding a lock.) A thread that waits for another one to end is harmless
/// anywhere. Frames before `first` do not count. Async-signal-safe.
Judgement judge(const CallStack& stack, Caution caution, std::size_t first = 0) noexcept;

/// Which frame threw the exception that was caught nowhere, so that no function has left the stack.
/// The frames before it are the C++ library's and ours. 0 without one. Async-signal-safe.
std::size_t thrower_in(const CallStack& stack) noexcept;

}  // namespace play_launch::isolation
