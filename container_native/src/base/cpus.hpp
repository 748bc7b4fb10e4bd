#pragma once

#include <cstddef>

namespace play_launch {

/// CPUs that the calling thread may run on, at least 1.
std::size_t usable_cpus() noexcept;

/// Threads for the executor of all nodes of a process: what was asked for, else one per usable CPU,
/// but at least 2.
std::size_t executor_threads(std::size_t asked) noexcept;

/// Threads for the executor of a single node: what was asked for, else one per usable CPU, but at
/// least 2 and at most 4.
std::size_t node_executor_threads(std::size_t asked) noexcept;

}  // namespace play_launch
