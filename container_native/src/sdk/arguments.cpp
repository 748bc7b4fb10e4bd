#include "arguments.hpp"

#include <rcl/error_handling.h>
#include <rcl/log_level.h>
#include <rcl_yaml_param_parser/parser.h>

#include <memory>
#include <play_launch/context.hpp>
#include <play_launch/error.hpp>
#include <play_launch/qos.hpp>
#include <stdexcept>
#include <string_view>
#include <vector>

namespace play_launch {
namespace {

std::vector<std::string> command_line(const NodeOptions& options) {
  std::vector<std::string> line{RCL_ROS_ARGS_FLAG};
  // The first rule that fits is applied, so these two come first.
  if (!options.name.empty()) {
    line.insert(line.end(), {RCL_REMAP_FLAG, "__node:=" + options.name});
  }
  if (!options.name_space.empty()) {
    const bool absolute = options.name_space.front() == '/';
    line.insert(line.end(),
                {RCL_REMAP_FLAG, "__ns:=" + std::string(absolute ? "" : "/") + options.name_space});
  }
  line.insert(line.end(), options.arguments.begin(), options.arguments.end());
  return line;
}

void refuse_unknown(const rcl_arguments_t& arguments, const std::vector<std::string>& line) {
  const int count = rcl_arguments_get_count_unparsed_ros(&arguments);
  if (count <= 0) return;
  int* indices = nullptr;
  const rcl_allocator_t allocator = rcl_get_default_allocator();
  throw_unless_ok(rcl_arguments_get_unparsed_ros(&arguments, allocator, &indices),
                  "find the unknown arguments of a node");
  std::string text = "unknown ROS argument of a node:";
  for (int i = 0; i < count; ++i) text += " " + line.at(static_cast<std::size_t>(indices[i]));
  allocator.deallocate(indices, allocator.state);
  throw std::invalid_argument(text);
}

template <class T, class Array>
std::vector<T> copy_of(const Array& array) {
  return std::vector<T>(array.values, array.values + array.size);
}

ParameterValue value_of(const rcl_variant_t& variant) {
  if (variant.bool_value != nullptr) return *variant.bool_value;
  if (variant.integer_value != nullptr) return *variant.integer_value;
  if (variant.double_value != nullptr) return *variant.double_value;
  if (variant.string_value != nullptr) return std::string(variant.string_value);
  if (variant.byte_array_value != nullptr) return copy_of<std::uint8_t>(*variant.byte_array_value);
  if (variant.bool_array_value != nullptr) return copy_of<bool>(*variant.bool_array_value);
  if (variant.integer_array_value != nullptr) {
    return copy_of<std::int64_t>(*variant.integer_array_value);
  }
  if (variant.double_array_value != nullptr) return copy_of<double>(*variant.double_array_value);
  if (variant.string_array_value != nullptr) {
    const auto& array = *variant.string_array_value;
    return std::vector<std::string>(array.data, array.data + array.size);
  }
  return std::monostate();
}

void add_overrides(const rcl_arguments_t& arguments, const std::string& full_name,
                   std::map<std::string, ParameterValue>& overrides) {
  rcl_params_t* raw = nullptr;
  throw_unless_ok(rcl_arguments_get_param_overrides(&arguments, &raw),
                  "read the parameters for node '" + full_name + "'");
  if (raw == nullptr) return;
  const std::unique_ptr<rcl_params_t, decltype(&rcl_yaml_node_struct_fini)> params(
      raw, &rcl_yaml_node_struct_fini);
  for (std::size_t n = 0; n < params->num_nodes; ++n) {
    if (!parameter_section_matches(params->node_names[n], full_name)) continue;
    const rcl_node_params_t& section = params->params[n];
    for (std::size_t p = 0; p < section.num_params; ++p) {
      overrides[section.parameter_names[p]] = value_of(section.parameter_values[p]);
    }
  }
}

std::vector<std::string_view> tokens_of(std::string_view name) {
  std::vector<std::string_view> tokens;
  while (!name.empty()) {
    const auto end = name.find('/');
    if (end != 0) tokens.push_back(name.substr(0, end));
    name.remove_prefix(end == std::string_view::npos ? name.size() : end + 1);
  }
  return tokens;
}

using Token = std::vector<std::string_view>::const_iterator;

bool tokens_match(Token pattern, Token pattern_end, Token name, Token name_end) {
  if (pattern == pattern_end) return name == name_end;
  if (*pattern == "**") {
    return tokens_match(pattern + 1, pattern_end, name, name_end) ||
           (name != name_end && tokens_match(pattern, pattern_end, name + 1, name_end));
  }
  return name != name_end && (*pattern == "*" || *pattern == *name) &&
         tokens_match(pattern + 1, pattern_end, name + 1, name_end);
}

}  // namespace

bool parameter_section_matches(const std::string& section, const std::string& full_name) {
  const auto pattern = tokens_of(section);
  const auto name = tokens_of(full_name);
  return tokens_match(pattern.begin(), pattern.end(), name.begin(), name.end());
}

NodeArguments::NodeArguments(const NodeOptions& options)
    : options_(options), rcl_options_(rcl_node_get_default_options()) {
  if (options.context == nullptr) throw std::invalid_argument("NodeOptions: there is no context");
  const auto line = command_line(options);
  std::vector<const char*> argv;
  argv.reserve(line.size());
  for (const auto& argument : line) argv.push_back(argument.c_str());
  throw_unless_ok(rcl_parse_arguments(static_cast<int>(argv.size()), argv.data(),
                                      rcl_get_default_allocator(), &rcl_options_.arguments),
                  "understand the arguments of a node");
  try {
    refuse_unknown(rcl_options_.arguments, line);
  } catch (...) {
    if (rcl_node_options_fini(&rcl_options_) != RCL_RET_OK) rcl_reset_error();
    throw;
  }
  rcl_options_.use_global_arguments = options.use_global_arguments;
  rcl_options_.enable_rosout = options.enable_rosout;
  rcl_options_.rosout_qos = QoS::rosout().profile();
}

NodeArguments::~NodeArguments() {
  if (rcl_node_options_fini(&rcl_options_) != RCL_RET_OK) rcl_reset_error();
}

std::map<std::string, ParameterValue> NodeArguments::parameter_overrides(
    const std::string& full_name) const {
  std::map<std::string, ParameterValue> overrides;
  if (options_.use_global_arguments) {
    add_overrides(options_.context->rcl()->global_arguments, full_name, overrides);
  }
  add_overrides(rcl_options_.arguments, full_name, overrides);
  for (const auto& parameter : options_.parameter_overrides) {
    overrides[parameter.name] = parameter.value;
  }
  return overrides;
}

int NodeArguments::log_level(const std::string& logger_name) const {
  if (options_.log_level != 0) return options_.log_level;
  rcl_log_levels_t levels = rcl_get_zero_initialized_log_levels();
  if (rcl_arguments_get_log_levels(&rcl_options_.arguments, &levels) != RCL_RET_OK) {
    rcl_reset_error();
    return 0;
  }
  int level = static_cast<int>(levels.default_logger_level);
  for (std::size_t i = 0; i < levels.num_logger_settings; ++i) {
    if (logger_name == levels.logger_settings[i].name) {
      level = static_cast<int>(levels.logger_settings[i].level);
    }
  }
  if (rcl_log_levels_fini(&levels) != RCL_RET_OK) rcl_reset_error();
  return level;
}

}  // namespace play_launch
