#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace play_launch::topics {

/// What the supervisor wants recorded, from the command line.
struct Options {
  /// Number of the socket to the supervisor.
  int socket = -1;
  /// Names of topics, or patterns, see selection.hpp.
  std::vector<std::string> topics;
  std::vector<std::string> excluded;
  /// Those that are kept in memory until they are asked for.
  std::vector<std::string> held;
  /// Bytes per second that may be recorded of each topic; 0 for any number.
  std::uint64_t budget = 0;
  /// Such numbers for some topics, by name or pattern; the first that matches holds.
  std::vector<std::pair<std::string, std::uint64_t>> topic_budgets;
  /// What is added to the time since boot, in nanoseconds: log times are those of the session's
  /// clock.
  std::int64_t clock_offset = 0;
  /// How long a node may take to give its parameters, in nanoseconds.
  std::int64_t answer_timeout = 5'000'000'000;
  /// How much of `held` is kept: nanoseconds, and bytes of all of them together.
  std::int64_t hold_time = 0;
  std::uint64_t hold_size = 0;
};

/// Throws std::invalid_argument with what is wrong.
Options parse_options(int argc, const char* const* argv);

}  // namespace play_launch::topics
