#pragma once

#include <sys/types.h>

#include <cstdint>

namespace play_launch::container {

/// Names a process for good: process ids are used again, pairs with the start time are not.
struct ProcessIdentity {
  pid_t pid = 0;
  std::uint64_t start_time = 0;  // clock ticks after boot, /proc/<pid>/stat field 22; 0: unknown
};

ProcessIdentity identity_of(pid_t pid);

}  // namespace play_launch::container
