#include "topic_recorder/parameters_message.hpp"

#include <rcl/error_handling.h>
#include <rmw/rmw.h>

#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <string>
#include <type_traits>
#include <vector>

#include "topic_recorder/message_in_chunk.hpp"

namespace play_launch::topics {

using play_launch_msgs::msg::NodeParameters;
using rcl_interfaces::msg::Parameter;
using rcl_interfaces::msg::ParameterValue;

namespace {

/// Counts the bytes of values in CDR. What rmw_serialize() calls a message's length is the estimate
/// that it took memory by: with empty lists it is too large, and strict readers refuse the rest.
class CdrSize {
 public:
  std::size_t bytes() const { return kEncapsulation + size_; }

  template <class... Values>
  void add(const Values&... values) {
    (value(values), ...);
  }

 private:
  static constexpr std::size_t kEncapsulation = 4;

  void scalar(std::size_t size) { size_ = (size_ + size - 1) / size * size + size; }

  template <class Number>
    requires std::is_arithmetic_v<Number>
  void value(const Number&) {
    scalar(sizeof(Number));
  }
  void value(const std::string& text) {
    scalar(sizeof(std::uint32_t));
    size_ += text.size() + 1;
  }
  void value(const std::vector<bool>& list) {
    scalar(sizeof(std::uint32_t));
    size_ += list.size();
  }
  template <class Each>
  void value(const std::vector<Each>& list) {
    scalar(sizeof(std::uint32_t));
    for (const Each& each : list) {
      value(each);
    }
  }
  void value(const ParameterValue& of) {
    add(of.type, of.bool_value, of.integer_value, of.double_value, of.string_value,
        of.byte_array_value, of.bool_array_value, of.integer_array_value, of.double_array_value,
        of.string_array_value);
  }
  void value(const Parameter& of) { add(of.name, of.value); }

  std::size_t size_ = 0;
};

}  // namespace

std::optional<std::size_t> put(NodeParameters parameters, std::uint64_t now, ChunkBuilder& chunk) {
  constexpr std::uint64_t kSecond = 1'000'000'000;
  parameters.stamp.sec = static_cast<std::int32_t>(now / kSecond);
  parameters.stamp.nanosec = static_cast<std::uint32_t>(now % kSecond);
  rmw_serialized_message_t message = message_in(chunk);
  const auto* const support =
      rosidl_typesupport_cpp::get_message_type_support_handle<NodeParameters>();
  if (rmw_serialize(&parameters, support, &message) != RMW_RET_OK) {
    rcl_reset_error();
    return std::nullopt;
  }
  CdrSize size;
  size.add(parameters.stamp.sec, parameters.stamp.nanosec, parameters.node, parameters.parameters,
           parameters.error);
  return size.bytes();
}

}  // namespace play_launch::topics
