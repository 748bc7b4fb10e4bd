#include "components/component_options.hpp"

#include <cxxabi.h>
#include <rcl/arguments.h>
#include <rcl/error_handling.h>
#include <rmw/error_handling.h>
#include <rmw/validate_namespace.h>
#include <rmw/validate_node_name.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <exception>
#include <rcl_interfaces/msg/parameter_type.hpp>
#include <string>
#include <string_view>
#include <typeinfo>

#include "base/elf.hpp"

namespace play_launch::container {
namespace {

using rcl_interfaces::msg::Parameter;
using rcl_interfaces::msg::ParameterType;

constexpr std::uint8_t kHighestLogLevel = 50;  // rcl_interfaces/Log FATAL

void check_node_name(const std::string& name) {
  int result = RMW_NODE_NAME_VALID;
  std::size_t where = 0;
  if (rmw_validate_node_name(name.c_str(), &result, &where) != RMW_RET_OK) {
    rmw_reset_error();
    return;  // no verdict; creating the node will show
  }
  if (result != RMW_NODE_NAME_VALID) {
    throw LoadError("node name '" + name + "': " + rmw_node_name_validation_result_string(result) +
                    " (at character " + std::to_string(where + 1) + ")");
  }
}

std::string absolute(const std::string& name_space) {
  return name_space.empty() || name_space.front() == '/' ? name_space : "/" + name_space;
}

void check_namespace(const std::string& given) {
  int result = RMW_NAMESPACE_VALID;
  std::size_t where = 0;
  if (rmw_validate_namespace(absolute(given).c_str(), &result, &where) != RMW_RET_OK) {
    rmw_reset_error();
    return;
  }
  if (result != RMW_NAMESPACE_VALID) {
    throw LoadError("node namespace '" + given +
                    "': " + rmw_namespace_validation_result_string(result));
  }
}

/// Asks the library that will read the rule later, so that both agree on what a rule is.
void check_remap_rule(const std::string& rule) {
  const std::array<const char*, 3> argv{"--ros-args", "-r", rule.c_str()};
  rcl_arguments_t arguments = rcl_get_zero_initialized_arguments();
  const rcl_ret_t parsed = rcl_parse_arguments(static_cast<int>(argv.size()), argv.data(),
                                               rcl_get_default_allocator(), &arguments);
  if (parsed == RCL_RET_OK) {
    if (rcl_arguments_fini(&arguments) != RCL_RET_OK) {
      rcl_reset_error();
    }
    return;
  }
  const std::string detail = rcl_error_is_set() ? rcl_get_error_string().str : "";
  rcl_reset_error();
  throw LoadError("remap rule '" + rule + "' is not of the form from:=to: " + detail);
}

bool bool_argument(const Parameter& argument) {
  if (argument.value.type != ParameterType::PARAMETER_BOOL) {
    // As rclcpp_components.
    throw LoadError("Extra component argument '" + argument.name + "' must be a boolean");
  }
  return argument.value.bool_value;
}

void check_parameters(const std::vector<Parameter>& parameters, const char* what) {
  for (const Parameter& parameter : parameters) {
    if (parameter.name.empty()) {
      throw LoadError(std::string(what) + " without a name");
    }
    if (parameter.value.type > ParameterType::PARAMETER_STRING_ARRAY) {
      throw LoadError(std::string(what) + " '" + parameter.name + "' has the unknown type number " +
                      std::to_string(parameter.value.type));
    }
  }
}

/// Whether the rule renames the node instead of a topic or service.
bool renames_node(const std::string& rule) {
  return std::ranges::any_of(
      std::array<std::string_view, 3>{"__node:=", "__name:=", "__ns:="},
      [&rule](std::string_view target) { return rule.find(target) != std::string::npos; });
}

}  // namespace

ComponentOptions component_options(const LoadRequest& request) {
  ComponentOptions options;
  if (!request.node_name.empty()) {
    check_node_name(request.node_name);
  }
  if (!request.node_namespace.empty()) {
    check_namespace(request.node_namespace);
  }
  if (request.log_level > kHighestLogLevel) {
    throw LoadError("log level " + std::to_string(request.log_level) +
                    " is not one of 10, 20, 30, 40, 50 (debug to fatal) or 0");
  }
  check_parameters(request.parameters, "parameter");
  check_parameters(request.extra_arguments, "extra argument");
  options.node_name = request.node_name;
  options.node_namespace = absolute(request.node_namespace);
  options.log_level = request.log_level;
  options.parameters = request.parameters;
  for (const std::string& rule : request.remap_rules) {
    check_remap_rule(rule);
    options.arguments.insert(options.arguments.end(), {"-r", rule});
  }
  for (const Parameter& argument : request.extra_arguments) {
    if (argument.name == "use_intra_process_comms") {
      options.use_intra_process_comms = bool_argument(argument);
    } else if (argument.name == "forward_global_arguments") {
      options.forward_global_arguments = bool_argument(argument);
    } else {
      options.extra_arguments.push_back(argument);
    }
  }
  return options;
}

std::optional<std::string> expected_full_name(const LoadRequest& request) {
  if (request.node_name.empty() || std::ranges::any_of(request.remap_rules, renames_node)) {
    return std::nullopt;
  }
  const std::string name_space = absolute(request.node_namespace);
  return (name_space == "/" ? "" : name_space) + "/" + request.node_name;
}

namespace {

/// Bytes. A text that is too long for a frame would be dropped whole, and this much is not read.
constexpr std::size_t kLongestText = 16 * 1024;

/// At most that of it, cut between two characters (UTF-8).
std::string shortened(std::string text) {
  if (text.size() <= kLongestText) {
    return text;
  }
  const auto continues = [](char byte) {
    return (static_cast<unsigned char>(byte) & 0xc0) == 0x80;
  };
  const std::string whole = std::to_string(text.size());
  std::size_t end = kLongestText;
  while (end > 0 && continues(text[end])) {
    --end;
  }
  text.resize(end);
  return text + "... (cut, of " + whole + " bytes)";
}

std::string describe(const std::exception& error) {
  std::string text = demangled(typeid(error).name()) + ": " + error.what();
  try {
    std::rethrow_if_nested(error);
  } catch (const std::exception& cause) {
    text += "; caused by " + describe(cause);
  } catch (...) {
    text += "; caused by something that is no std::exception";
  }
  return text;
}

}  // namespace

std::string describe_current_exception() {
  try {
    throw;
  } catch (const LoadError& error) {
    return error.what();
  } catch (const std::exception& error) {
    return shortened(describe(error));
  } catch (...) {
    const std::type_info* type = abi::__cxa_current_exception_type();
    return "an exception of type " + (type != nullptr ? demangled(type->name()) : "unknown");
  }
}

}  // namespace play_launch::container
