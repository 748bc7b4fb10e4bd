#include "topic_recorder/options.hpp"

#include <charconv>
#include <stdexcept>
#include <string_view>

namespace play_launch::topics {
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
