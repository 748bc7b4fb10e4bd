#pragma once

/// Makes a process with the system call `number`, clone(one: flags, two: 0) or clone3(one:
/// arguments, two: their size), without a stack for it: it goes on on the caller's, so the flags
/// must have CLONE_VM. All signals must be blocked.
///
/// In the child: exits with what entry(argument) returns; never returns. In the parent: returns
/// when no thread of the child is left, and before it is reaped, its pid, or at once a negative
/// errno. Until then the parent touches neither the stack nor anything else in memory.
extern "C" long play_launch_clone_on_own_stack(long number, unsigned long one, unsigned long two,
                                               int (*entry)(void*), void* argument);
