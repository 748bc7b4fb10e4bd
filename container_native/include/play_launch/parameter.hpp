#pragma once

#include <cstdint>
#include <rcl_interfaces/msg/parameter.hpp>
#include <rcl_interfaces/msg/parameter_value.hpp>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

namespace play_launch {

/// Value of a parameter. The index of the alternative is the number that
/// rcl_interfaces/ParameterType gives the type; monostate (0) means "not set".
using ParameterValue =
    std::variant<std::monostate, bool, std::int64_t, double, std::string, std::vector<std::uint8_t>,
                 std::vector<bool>, std::vector<std::int64_t>, std::vector<double>,
                 std::vector<std::string>>;

/// A named value.
struct Parameter {
  std::string name;
  ParameterValue value;

  bool operator==(const Parameter&) const = default;
};

/// The type's name as users know it: "not set", "bool", "integer", "double", "string",
/// "byte_array", "bool_array", "integer_array", "double_array", "string_array".
/// `type` is a number of rcl_interfaces/ParameterType; an unknown one gives "unknown".
[[nodiscard]] const char* parameter_type_name(std::size_t type) noexcept;

/// Name of the type that the value has.
[[nodiscard]] inline const char* parameter_type_name(const ParameterValue& value) noexcept {
  return parameter_type_name(value.index());
}

/// Conversions to and from the messages of rcl_interfaces. A message with an unknown type number
/// becomes "not set".
[[nodiscard]] rcl_interfaces::msg::ParameterValue to_message(const ParameterValue& value);
[[nodiscard]] rcl_interfaces::msg::Parameter to_message(const Parameter& parameter);
[[nodiscard]] ParameterValue from_message(const rcl_interfaces::msg::ParameterValue& message);
[[nodiscard]] Parameter from_message(const rcl_interfaces::msg::Parameter& message);
[[nodiscard]] std::vector<Parameter> from_messages(
    const std::vector<rcl_interfaces::msg::Parameter>& messages);

namespace detail {

/// The alternative of ParameterValue that stores a T: itself, or the widest type of its kind.
template <class T>
struct ParameterStorage {
  using type = T;
};
template <class T>
  requires(std::is_integral_v<T> && !std::is_same_v<T, bool>)
struct ParameterStorage<T> {
  using type = std::int64_t;
};
template <class T>
  requires std::is_floating_point_v<T>
struct ParameterStorage<T> {
  using type = double;
};

template <class T>
using parameter_storage_t = typename ParameterStorage<T>::type;

}  // namespace detail

}  // namespace play_launch
