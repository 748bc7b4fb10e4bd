#pragma once

#include <sys/types.h>

namespace play_launch::container {

/// Whether fork_beside_us() can be used: the kernel says where the C library keeps the number of
/// this thread (it does where it can checkpoint processes, as distributions' kernels can).
bool can_fork_beside_us();

/// fork(), but the child's parent is ours (CLONE_PARENT). Handlers of pthread_atfork() do not run:
/// only for a process whose other threads hold no lock.
pid_t fork_beside_us();

}  // namespace play_launch::container
