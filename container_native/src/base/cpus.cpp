#include "base/cpus.hpp"

#include <sched.h>

#include <algorithm>
#include <thread>

namespace play_launch {

std::size_t usable_cpus() noexcept {
  cpu_set_t cpus;
  CPU_ZERO(&cpus);
  // It fails where the machine has more than fit in there.
  const std::size_t count = ::sched_getaffinity(0, sizeof cpus, &cpus) == 0
                                ? static_cast<std::size_t>(CPU_COUNT(&cpus))
                                : std::thread::hardware_concurrency();
  return std::max<std::size_t>(count, 1);
}

std::size_t executor_threads(std::size_t asked) noexcept {
  return asked != 0 ? asked : std::max<std::size_t>(2, usable_cpus());
}

std::size_t node_executor_threads(std::size_t asked) noexcept {
  constexpr std::size_t kMostByDefault = 4;
  return asked != 0 ? asked : std::min(executor_threads(0), kMostByDefault);
}

}  // namespace play_launch
