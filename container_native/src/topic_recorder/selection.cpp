#include "topic_recorder/selection.hpp"

#include <fnmatch.h>
#include <rmw/qos_profiles.h>

#include <algorithm>
#include <charconv>
#include <set>
#include <stdexcept>
#include <string_view>
#include <vector>

namespace play_launch::topics {
namespace {

bool any_matches(const std::vector<std::string>& patterns, const std::string& topic) {
  return std::ranges::any_of(patterns,
                             [&](const std::string& pattern) { return matches(pattern, topic); });
}

}  // namespace

bool is_hidden(std::string_view name) { return name.find("/_") != std::string_view::npos; }

bool asks_for_parameters(const Options& options) {
  return !any_matches(options.excluded, kParametersTopic);
}

bool matches(const std::string& pattern, const std::string& topic) {
  if (pattern == topic) {
    return true;
  }
  if (is_hidden(topic) && !is_hidden(pattern)) {
    return false;
  }
  return ::fnmatch(pattern.c_str(), topic.c_str(), FNM_NOESCAPE) == 0;
}

std::uint64_t budget_of(const Options& options, const std::string& topic) {
  const auto place = std::ranges::find_if(
      options.topic_budgets, [&](const auto& each) { return matches(each.first, topic); });
  return place == options.topic_budgets.end() ? options.budget : place->second;
}

bool is_measured(const Options& options, const std::string& topic) {
  return any_matches(options.measured, topic);
}

bool is_pattern(std::string_view name) {
  return name.find_first_of("*?") != std::string_view::npos;
}

Treatment treatment(const Options& options, const std::string& topic) {
  if (topic.starts_with("/play_launch/")) {
    return Treatment::none;
  }
  if (!any_matches(options.excluded, topic)) {
    if (any_matches(options.topics, topic)) {
      return Treatment::recorded;
    }
    if (any_matches(options.held, topic)) {
      return Treatment::held;
    }
  }
  return is_measured(options, topic) ? Treatment::measured : Treatment::none;
}

namespace {

/// Messages that wait in the middleware until our thread gets a processor: a second of a topic at
/// 1 kHz. It takes them all the time, also those that there is no room for; so few wait.
constexpr std::size_t kDepth = 1000;

std::string seconds(const rmw_time_t& time) {
  return "{sec: " + std::to_string(time.sec) + ", nsec: " + std::to_string(time.nsec) + "}";
}

std::string as_yaml(const rmw_qos_profile_t& profile) {
  return "- history: " + std::to_string(static_cast<int>(profile.history)) +
         "\n  depth: " + std::to_string(profile.depth) +
         "\n  reliability: " + std::to_string(static_cast<int>(profile.reliability)) +
         "\n  durability: " + std::to_string(static_cast<int>(profile.durability)) +
         "\n  deadline: " + seconds(profile.deadline) +
         "\n  lifespan: " + seconds(profile.lifespan) +
         "\n  liveliness: " + std::to_string(static_cast<int>(profile.liveliness)) +
         "\n  liveliness_lease_duration: " + seconds(profile.liveliness_lease_duration) +
         "\n  avoid_ros_namespace_conventions: " +
         (profile.avoid_ros_namespace_conventions ? "true" : "false");
}

}  // namespace

bool is_reliable(const rmw_qos_profile_t& profile) {
  return profile.reliability == RMW_QOS_POLICY_RELIABILITY_RELIABLE;
}

bool is_latched(const rmw_qos_profile_t& profile) {
  return profile.durability == RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL;
}

rmw_qos_profile_t request_for(const std::vector<rmw_qos_profile_t>& offered, Treatment treatment) {
  rmw_qos_profile_t request = rmw_qos_profile_default;
  request.history = RMW_QOS_POLICY_HISTORY_KEEP_LAST;
  request.depth = kDepth;
  if (treatment == Treatment::measured) {
    request.reliability = RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
    request.durability = RMW_QOS_POLICY_DURABILITY_VOLATILE;
    return request;
  }
  request.reliability = std::ranges::all_of(offered, is_reliable)
                            ? RMW_QOS_POLICY_RELIABILITY_RELIABLE
                            : RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
  request.durability = RMW_QOS_POLICY_DURABILITY_VOLATILE;
  if (std::ranges::all_of(offered, is_latched)) {
    request.durability = RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL;
    // A reader that keeps less than such a publisher gets less of what was said before.
    for (const rmw_qos_profile_t& profile : offered) {
      request.depth = std::max(request.depth, std::min<std::size_t>(profile.depth, 10 * kDepth));
    }
  }
  return request;
}

bool asks_too_much(const rmw_qos_profile_t& present, const rmw_qos_profile_t& wanted) {
  return (is_reliable(present) && !is_reliable(wanted)) ||
         (is_latched(present) && !is_latched(wanted));
}

std::string offered_qos_profiles(const std::vector<rmw_qos_profile_t>& offered) {
  // Equal ones once: a hundred nodes publish on /rosout.
  std::set<std::string> known;
  std::string text;
  for (const rmw_qos_profile_t& profile : offered) {
    const std::string entry = as_yaml(profile);
    if (known.insert(entry).second) {
      text += (text.empty() ? "" : "\n") + entry;
    }
  }
  return text;
}

namespace {

template <class Number>
Number number(std::string_view option, std::string_view text) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || value < Number{}) {
    throw std::invalid_argument(std::string(option) + ": not a number: " + std::string(text));
  }
  return value;
}

}  // namespace

Options parse_options(int argc, const char* const* argv) {
  Options options;
  for (int at = 1; at < argc; at += 2) {
    const std::string_view option = argv[at];
    if (at + 1 >= argc) {
      throw std::invalid_argument(std::string(option) + ": its value is missing");
    }
    const std::string_view value = argv[at + 1];
    if (option == "--socket") {
      options.socket = number<int>(option, value);
    } else if (option == "--topic") {
      options.topics.emplace_back(value);
    } else if (option == "--exclude") {
      options.excluded.emplace_back(value);
    } else if (option == "--held") {
      options.held.emplace_back(value);
    } else if (option == "--measure") {
      options.measured.emplace_back(value);
    } else if (option == "--budget") {
      options.budget = number<std::uint64_t>(option, value);
    } else if (option == "--topic-budget") {
      const std::size_t end = value.rfind('=');
      if (end == std::string_view::npos) {
        throw std::invalid_argument(std::string(option) + ": no number: " + std::string(value));
      }
      options.topic_budgets.emplace_back(value.substr(0, end),
                                         number<std::uint64_t>(option, value.substr(end + 1)));
    } else if (option == "--clock-offset") {
      options.clock_offset = std::stoll(std::string(value));
    } else if (option == "--answer-timeout") {
      options.answer_timeout = number<std::int64_t>(option, value);
    } else if (option == "--hold-time") {
      options.hold_time = number<std::int64_t>(option, value);
    } else if (option == "--hold-size") {
      options.hold_size = number<std::uint64_t>(option, value);
    } else {
      throw std::invalid_argument("unknown option " + std::string(option));
    }
  }
  if (options.socket < 0) {
    throw std::invalid_argument("--socket is missing");
  }
  return options;
}

}  // namespace play_launch::topics
