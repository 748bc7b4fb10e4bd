#pragma once

#include <rmw/types.h>

#include <cstdint>
#include <string>
#include <string_view>
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
  /// Names of topics, or patterns, of which is reported what comes.
  std::vector<std::string> measured;
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

/// What is done with a topic.
enum class Treatment {
  none,
  /// Recorded as it comes.
  recorded,
  /// Kept in memory until it is asked for.
  held,
  /// Counted only.
  measured,
};

/// What users read of it.
constexpr const char* in_words(Treatment treatment) {
  return treatment == Treatment::measured ? "measured" : "recorded";
}

/// Whether a name fits a pattern: `*` stands for any text, slashes included, `?` for one character.
/// A pattern does not reach hidden topics (a part begins with `_`) unless it names such a part.
bool matches(const std::string& pattern, const std::string& topic);

/// Whether a part of a name begins with `_`.
bool is_hidden(std::string_view name);

/// Bytes per second that may be recorded of a topic; 0 for any number.
std::uint64_t budget_of(const Options& options, const std::string& topic);

/// Where the parameters of nodes are recorded.
constexpr const char* kParametersTopic = "/play_launch/parameters";

/// Whether nodes are to be asked for their parameters.
bool asks_for_parameters(const Options& options);

/// Whether it is reported what comes on a topic.
bool is_measured(const Options& options, const std::string& topic);

/// Whether a name is a pattern.
bool is_pattern(std::string_view name);

/// What is both asked for as it comes and to be held is recorded as it comes. Never topics below
/// /play_launch: those are the supervisor's own, played back from a recording. What is recorded or
/// held can be measured as well.
Treatment treatment(const Options& options, const std::string& topic);

/// Whether every message is delivered, by what a publisher offers.
bool is_reliable(const rmw_qos_profile_t& profile);

/// Whether late subscriptions get earlier messages, by what a publisher offers.
bool is_latched(const rmw_qos_profile_t& profile);

/// What to ask for so that every one of these publishers is heard: reliable and transient_local
/// only where all of them are, as rosbag2 does. `offered` is not empty.
/// What is only measured is neither acknowledged nor sent again, which spares both ends.
rmw_qos_profile_t request_for(const std::vector<rmw_qos_profile_t>& offered, Treatment treatment);

/// Whether a subscription that asks for `present` does not hear publishers that `wanted` does.
bool asks_too_much(const rmw_qos_profile_t& present, const rmw_qos_profile_t& wanted);

/// The profiles as rosbag2 stores them beside a channel, in YAML; policies as numbers, which every
/// rosbag2 from Foxy on reads.
std::string offered_qos_profiles(const std::vector<rmw_qos_profile_t>& offered);

}  // namespace play_launch::topics
