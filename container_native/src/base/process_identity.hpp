#pragma once

#include <sys/types.h>

#include <cstdint>

namespace play_launch {

/// Names a process for good: process ids are used again, pairs with the start time are not.
struct ProcessIdentity {
  pid_t pid = 0;
  std::uint64_t start_time = 0;  // clock ticks after boot, /proc/<pid>/stat field 22; 0: unknown
};

/// Of any process whose /proc entry can be read. Async-signal-safe, as is the other.
ProcessIdentity identity_of(pid_t pid) noexcept;

/// The calling process's start time; 0 when /proc cannot be read.
std::uint64_t start_time_of_self() noexcept;

}  // namespace play_launch
