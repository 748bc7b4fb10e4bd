#pragma once

#include <sched.h>

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace play_launch {

/// One thing that the kernel is asked to do differently for a process. It applies to the calling
/// thread, or to its process, and what these start afterwards inherits it.
///
/// As text, numbers are decimal:
///   rlimit RESOURCE SOFT HARD      as setrlimit(2) numbers them; 18446744073709551615: unlimited
///   oom_score_adj NUMBER
///   io_priority NUMBER             class << 13 | level, see ioprio_set(2)
///   cpu_affinity CPU...
///   nice NUMBER
///   scheduler POLICY PRIORITY      see sched_setscheduler(2)
///   cgroup FOLDER                  of a control group to enter, its absolute path
///   required_cgroup FOLDER         the same; a process that is refused ends
struct ResourceSetting {
  enum class Kind { rlimit, oom_score_adj, io_priority, cpu_affinity, nice, scheduler, cgroup };

  Kind kind = Kind::nice;
  std::array<std::uint64_t, 3> numbers{};  // negative ones in two's complement
  cpu_set_t cpus{};                        // of cpu_affinity
  std::string folder;                      // of cgroup
  bool is_required = false;                // the process is not to run without it
};

/// Nothing when the text is malformed.
std::optional<ResourceSetting> parse_resource_setting(std::string_view text);

/// All of them, in their order. Throws std::invalid_argument that names the text.
std::vector<ResourceSetting> parse_resource_settings(const std::vector<std::string>& texts);

/// Asks the kernel. A limit that may not be raised so far gets as near as it may. False when it was
/// refused and the process is to end, after a line on standard error. Async-signal-safe, and keeps
/// errno.
bool apply_or_complain(const ResourceSetting& setting) noexcept;

/// Has the memory of this process stay in RAM: what is there now at once, and what comes later when
/// it is first touched. 0 or an error number: EPERM where a limit would let a later allocation
/// fail.
int lock_memory() noexcept;

}  // namespace play_launch
