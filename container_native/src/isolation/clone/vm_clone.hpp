#pragma once

#include "isolation/record/crash_slot.hpp"

namespace play_launch::isolation {

/// What a cloned process runs; what it returns is its exit status or, negative, -signal for the
/// signal that it then dies of.
using CloneEntry = int (*)(void* argument);

/// Where a process is born.
struct Birth {
  int group = -1;         // descriptor of a control group's folder; -1: that of its parent
  bool in_group = false;  // for the child: it is in there. Else it was refused
};

/// Runs entry(argument) in a new process that shares this one's memory and file descriptors, and
/// returns when that process is dead and reaped. The calling thread, the donor, waits meanwhile
/// without touching memory: the process runs on its stack and with its thread-local storage, which
/// makes it complete for the C library, whatever it does. The child starts with all signals blocked
/// and with this process's signal handlers. `before_reaping` is called on the donor when no thread
/// of the child is left, while its pid cannot be used again yet.
///
/// Afterwards the donor's state is what it was, as far as the C and C++ libraries keep any: errno,
/// signal mask, locale, exceptions, list of robust mutexes, id of the thread. thread_local objects
/// are what the child made of them, so the donor must not end like other threads, which destroy
/// them. So is the allocator's cache for this thread: after a child that did not return
/// (ChildEnd::returned) the donor must not use the allocator; see DonorThread.
///
/// Never throws, never allocates. An exception that leaves `entry` ends the child in
/// std::terminate, with the stack still as it was at the throw.
ChildEnd clone_and_wait(CloneEntry entry, void* argument, void (*before_reaping)(void*) = nullptr,
                        Birth* birth = nullptr) noexcept;

/// Whether a child of the calling thread did not return, so that the thread must not use the
/// allocator.
bool donor_is_tainted() noexcept;

/// Prepares this process for children, the first time: before the first of them, and not in one.
/// Null: all is ready. Else why no child must share this process's memory.
const char* prepare_clone();

}  // namespace play_launch::isolation

/// Makes a process with the system call `number`, clone(one: flags, two: 0) or clone3(one:
/// arguments, two: their size), without a stack for it: it goes on on the caller's, so the flags
/// must have CLONE_VM. All signals must be blocked.
///
/// In the child: exits with what entry(argument) returns; never returns. In the parent: returns
/// when no thread of the child is left, and before it is reaped, its pid, or at once a negative
/// errno. Until then the parent touches neither the stack nor anything else in memory.
extern "C" long play_launch_clone_on_own_stack(long number, unsigned long one, unsigned long two,
                                               int (*entry)(void*), void* argument);
