#pragma once

/// Makes system call `number` (clone3 or clone, without a stack for the child) with three
/// arguments. In the parent: gives its result, a pid or a negative errno. In the child: exits with
/// what entry(argument) returns; never returns.
extern "C" long play_launch_clone_syscall(long number, long first, long second, long third,
                                          int (*entry)(void*), void* argument);
