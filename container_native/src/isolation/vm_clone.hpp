#pragma once

#include <sys/types.h>

namespace play_launch::isolation {

/// What a cloned process runs; what it returns is its exit status.
using CloneEntry = int (*)(void* argument);

/// How a child ended.
struct ChildEnd {
  int error = 0;      // errno when there was no child at all; the rest is 0 then
  pid_t pid = 0;      // what it had; free to be used again by now
  int exit_code = 0;  // when it exited
  int signal = 0;     // when a signal ended it; else 0
  bool dumped_core = false;

  bool clean() const { return error == 0 && signal == 0 && exit_code == 0; }
};

/// Runs entry(argument) in a new process that shares this one's memory and file descriptors, and
/// returns when that process is dead. The calling thread, the donor, is suspended meanwhile: the
/// process runs on its stack and with its thread-local storage, which makes it complete for the C
/// library, whatever it does. The child starts with all signals blocked and with this process's
/// signal handlers. `before_reaping` is called on the donor when all threads of the child are gone,
/// while its pid cannot be used again yet.
///
/// Afterwards the donor's state is what it was, as far as the C and C++ libraries keep any: errno,
/// signal mask, locale, exceptions, list of robust mutexes, id of the thread. thread_local objects
/// are what the child made of them, and so is the allocator's cache for this thread: after a death
/// at any instant the donor must neither use the allocator nor end like other threads do; see
/// DonorThread.
///
/// Never throws, never allocates. An exception that leaves `entry` ends the child in
/// std::terminate, with the stack still as it was at the throw.
ChildEnd clone_and_wait(CloneEntry entry, void* argument, void (*before_reaping)(void*)) noexcept;

/// Whether processes can be made like that here: 0, or the errno that says why not. Makes one.
int try_clone() noexcept;

}  // namespace play_launch::isolation
