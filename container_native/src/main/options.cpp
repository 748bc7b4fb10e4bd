#include "main/options.hpp"

#include <array>
#include <charconv>
#include <cmath>
#include <string_view>
#include <utility>

namespace play_launch::container {
namespace {

constexpr std::string_view kRosArguments = "--ros-args";
constexpr double kLongestStop = 3600.0;  // seconds

/// The argument behind argv[index], which belongs to option `name`; `index` is moved to it.
std::string_view next_value(std::string_view name, int& index, int argc, const char* const* argv) {
  if (index + 1 >= argc || kRosArguments == argv[index + 1]) {
    throw UsageError(std::string(name) + " needs a value");
  }
  return argv[++index];
}

/// The value of option `name` that is at argv[index], either after "=" or in the next argument,
/// to which `index` is then moved.
std::string_view value_of(std::string_view name, int& index, int argc, const char* const* argv) {
  const std::string_view argument = argv[index];
  if (argument.size() > name.size()) {
    return argument.substr(name.size() + 1);
  }
  return next_value(name, index, argc, argv);
}

bool is_option(std::string_view argument, std::string_view name) {
  return argument == name || (argument.starts_with(name) && argument.size() > name.size() &&
                              argument[name.size()] == '=');
}

std::size_t thread_count(std::string_view text) {
  std::size_t value = 0;
  const char* const end = text.data() + text.size();
  const auto [parsed_to, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc() || parsed_to != end || value > kMaxThreads) {
    throw UsageError("--thread_num " + std::string(text) + ": expected a number from 0 to " +
                     std::to_string(kMaxThreads) + " (0: one per CPU)");
  }
  return value;
}

std::chrono::duration<double> seconds(std::string_view text) {
  double value = 0.0;
  const char* const end = text.data() + text.size();
  const auto [parsed_to, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc() || parsed_to != end || !std::isfinite(value) || value < 0.0 ||
      value > kLongestStop) {
    throw UsageError("--stop_timeout " + std::string(text) + ": expected seconds from 0 to 3600");
  }
  return std::chrono::duration<double>(value);
}

ResourceSetting resource(std::string_view text) {
  const auto setting = parse_resource_setting(text);
  if (!setting) {
    throw UsageError("--resource '" + std::string(text) + "': expected a setting such as 'nice 5'");
  }
  return *setting;
}

template <class Choice>
using Choices = std::array<std::pair<std::string_view, Choice>, 3>;

constexpr Choices<isolation::MechanismChoice> kMechanisms{{
    {"auto", isolation::MechanismChoice::automatic},
    {"shared_memory", isolation::MechanismChoice::shared_memory},
    {"process", isolation::MechanismChoice::process},
}};
constexpr Choices<DomainChoice> kDomains{{
    {"off", DomainChoice::off},
    {"auto", DomainChoice::automatic},
    {"required", DomainChoice::required},
}};

template <class Choice>
Choice choice(std::string_view option, std::string_view text, const Choices<Choice>& choices) {
  for (const auto& [name, value] : choices) {
    if (name == text) {
      return value;
    }
  }
  throw UsageError(std::string(option) + " " + std::string(text) + ": expected " +
                   std::string(choices[0].first) + ", " + std::string(choices[1].first) + " or " +
                   std::string(choices[2].first));
}

}  // namespace

std::string Options::mode() const {
  return isolated ? (multi_threaded ? "isolated_mt" : "isolated")
                  : (multi_threaded ? "mt" : "standard");
}

Options parse_options(int argc, const char* const* argv) {
  Options options;
  for (int i = 1; i < argc; ++i) {
    const std::string_view argument = argv[i];
    if (argument == kRosArguments) {
      while (i + 1 < argc && std::string_view(argv[i + 1]) != "--") {
        options.ros_arguments.emplace_back(argv[++i]);
      }
      ++i;
    } else if (argument == "--use_multi_threaded_executor") {
      options.multi_threaded = true;
    } else if (argument == "--isolated") {
      options.isolated = true;
    } else if (is_option(argument, "--isolation")) {
      options.isolation =
          choice("--isolation", value_of("--isolation", i, argc, argv), kMechanisms);
    } else if (is_option(argument, "--memory_domains")) {
      options.memory_domains =
          choice("--memory_domains", value_of("--memory_domains", i, argc, argv), kDomains);
    } else if (argument == "--hosted") {
      options.hosted = true;
    } else if (argument == "--core_dumps") {
      options.core_dumps = true;
    } else if (argument == "--lock_memory") {
      options.lock_memory = true;
    } else if (is_option(argument, "--resource")) {
      options.resources.push_back(resource(value_of("--resource", i, argc, argv)));
    } else if (is_option(argument, "--thread_num")) {
      options.thread_num = thread_count(value_of("--thread_num", i, argc, argv));
    } else if (is_option(argument, "--stop_timeout")) {
      options.stop_timeout = seconds(value_of("--stop_timeout", i, argc, argv));
    } else if (is_option(argument, "--failpoints")) {
      options.failpoints = value_of("--failpoints", i, argc, argv);
    } else if (argument == "--probe") {
      ProbeRequest& request = options.probe.emplace();
      request.package = next_value("--probe PACKAGE PLUGIN", i, argc, argv);
      request.plugin = next_value("--probe PACKAGE PLUGIN", i, argc, argv);
    } else if (argument == "--help" || argument == "-h") {
      options.help = true;
    } else if (argument == "--version") {
      options.version = true;
    } else {
      throw UsageError("unknown argument '" + std::string(argument) +
                       "' (ROS arguments belong behind --ros-args)");
    }
  }
  return options;
}

const char* usage() {
  return "usage: component_container [--use_multi_threaded_executor] [--thread_num N]\n"
         "                           [--isolated] [--isolation auto|shared_memory|process]\n"
         "                           [--memory_domains off|auto|required]\n"
         "                           [--core_dumps] [--lock_memory]\n"
         "                           [--stop_timeout SECONDS] [--ros-args ...]\n"
         "       component_container --probe PACKAGE PLUGIN\n"
         "       component_container --version\n";
}

}  // namespace play_launch::container
