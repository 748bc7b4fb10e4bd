#pragma once

#include <chrono>
#include <cstddef>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "base/resource_setting.hpp"
#include "hosts/cloned/memory_domains.hpp"
#include "isolation/clone/gate.hpp"

namespace play_launch::container {

/// Most threads of an executor that may be requested.
inline constexpr std::size_t kMaxThreads = 1024;

/// A component whose library is only tried out, see probe().
struct ProbeRequest {
  std::string package;
  std::string plugin;
};

/// What the command line asks for, ROS arguments aside.
struct Options {
  bool multi_threaded = false;
  bool isolated = false;
  isolation::MechanismChoice isolation = isolation::MechanismChoice::automatic;
  /// Set by a container for the processes that it starts: one node, no ROS services of its own.
  bool hosted = false;
  /// Isolated nodes that crash dump core.
  bool core_dumps = false;
  DomainChoice memory_domains = DomainChoice::off;
  /// What the process asks of the kernel for itself before it does anything else.
  std::vector<ResourceSetting> resources;
  bool lock_memory = false;
  std::optional<std::size_t> thread_num;  // nothing: parameter thread_num, or one per CPU
  std::chrono::duration<double> stop_timeout{2.0};
  std::optional<ProbeRequest> probe;
  std::string failpoints;  // what arm_failpoints() reads; empty: none
  bool help = false;
  bool version = false;
  std::vector<std::string> ros_arguments;  // all that stand behind --ros-args

  /// standard, mt, isolated or isolated_mt.
  std::string mode() const;
};

/// The command line makes no sense; the text has the reason.
class UsageError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Reads the arguments that are not ROS arguments (between --ros-args and --, or the end).
/// Throws UsageError.
Options parse_options(int argc, const char* const* argv);

/// Text for --help.
const char* usage();

}  // namespace play_launch::container
