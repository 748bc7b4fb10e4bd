#include <array>
#include <play_launch/parameter.hpp>
#include <rcl_interfaces/msg/parameter_type.hpp>

namespace play_launch {
namespace {

using Type = rcl_interfaces::msg::ParameterType;
using Message = rcl_interfaces::msg::ParameterValue;

constexpr std::array<const char*, 10> kTypeNames = {
    "not set",    "bool",       "integer",       "double",       "string",
    "byte_array", "bool_array", "integer_array", "double_array", "string_array"};
static_assert(kTypeNames.size() == std::variant_size_v<ParameterValue>);
static_assert(Type::PARAMETER_STRING_ARRAY == kTypeNames.size() - 1);

struct Fill {
  Message& message;
  void operator()(std::monostate) const {}
  void operator()(bool value) const { message.bool_value = value; }
  void operator()(std::int64_t value) const { message.integer_value = value; }
  void operator()(double value) const { message.double_value = value; }
  void operator()(const std::string& value) const { message.string_value = value; }
  void operator()(const std::vector<std::uint8_t>& value) const {
    message.byte_array_value = value;
  }
  void operator()(const std::vector<bool>& value) const { message.bool_array_value = value; }
  void operator()(const std::vector<std::int64_t>& value) const {
    message.integer_array_value = value;
  }
  void operator()(const std::vector<double>& value) const { message.double_array_value = value; }
  void operator()(const std::vector<std::string>& value) const {
    message.string_array_value = value;
  }
};

}  // namespace

const char* parameter_type_name(std::size_t type) noexcept {
  return type < kTypeNames.size() ? kTypeNames[type] : "unknown";
}

Message to_message(const ParameterValue& value) {
  Message message;
  message.type = static_cast<std::uint8_t>(value.index());
  std::visit(Fill{message}, value);
  return message;
}

rcl_interfaces::msg::Parameter to_message(const Parameter& parameter) {
  rcl_interfaces::msg::Parameter message;
  message.name = parameter.name;
  message.value = to_message(parameter.value);
  return message;
}

ParameterValue from_message(const Message& message) {
  switch (message.type) {
    case Type::PARAMETER_BOOL:
      return message.bool_value;
    case Type::PARAMETER_INTEGER:
      return message.integer_value;
    case Type::PARAMETER_DOUBLE:
      return message.double_value;
    case Type::PARAMETER_STRING:
      return message.string_value;
    case Type::PARAMETER_BYTE_ARRAY:
      return message.byte_array_value;
    case Type::PARAMETER_BOOL_ARRAY:
      return message.bool_array_value;
    case Type::PARAMETER_INTEGER_ARRAY:
      return message.integer_array_value;
    case Type::PARAMETER_DOUBLE_ARRAY:
      return message.double_array_value;
    case Type::PARAMETER_STRING_ARRAY:
      return message.string_array_value;
    default:
      return std::monostate();
  }
}

Parameter from_message(const rcl_interfaces::msg::Parameter& message) {
  return {message.name, from_message(message.value)};
}

std::vector<Parameter> from_messages(const std::vector<rcl_interfaces::msg::Parameter>& messages) {
  std::vector<Parameter> parameters;
  parameters.reserve(messages.size());
  for (const auto& message : messages) parameters.push_back(from_message(message));
  return parameters;
}

}  // namespace play_launch
