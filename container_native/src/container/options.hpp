#pragma once

#include <chrono>
#include <cstddef>
#include <optional>
#include <stdexcept>
#include <string>

namespace play_launch::container {

/// Most threads of an executor that anybody may ask for.
inline constexpr std::size_t kMaxThreads = 1024;

/// What the command line asks for, ROS arguments aside.
struct Options {
  bool multi_threaded = false;
  bool isolated = false;
  std::optional<std::size_t> thread_num;  // nothing: parameter thread_num, or one per CPU
  std::chrono::duration<double> stop_timeout{2.0};
  bool help = false;

  /// standard, mt, isolated or isolated_mt.
  std::string mode() const;
};

/// The command line makes no sense; the text says why.
class UsageError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Reads the arguments that are not ROS arguments (between --ros-args and --, or the end).
/// Throws UsageError.
Options parse_options(int argc, const char* const* argv);

/// Text for --help.
const char* usage();

/// Threads for an executor: what was asked for, else one per CPU, but at least 2.
std::size_t executor_threads(std::size_t asked);

}  // namespace play_launch::container
