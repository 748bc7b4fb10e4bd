#include "topic_recorder/selection.hpp"

#include <fnmatch.h>

#include <algorithm>
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

Treatment treatment(const Options& options, const std::string& topic) {
  if (topic.starts_with("/play_launch/") || any_matches(options.excluded, topic)) {
    return Treatment::none;
  }
  if (any_matches(options.topics, topic)) {
    return Treatment::recorded;
  }
  return any_matches(options.held, topic) ? Treatment::held : Treatment::none;
}

}  // namespace play_launch::topics
