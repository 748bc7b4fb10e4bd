#pragma once

#include <cstdint>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <span>
#include <vector>

namespace play_launch::control {

/// CDR bytes (with encapsulation header) of the message at `message`, which is of the type that
/// `type_support` describes. Throws std::runtime_error with the middleware's text on failure.
std::vector<std::uint8_t> serialize_message(const void* message,
                                            const rosidl_message_type_support_t* type_support);

/// Fills the message at `message` from CDR bytes. Throws ProtocolError when the bytes are no
/// message of that type.
void deserialize_message(std::span<const std::uint8_t> bytes,
                         const rosidl_message_type_support_t* type_support, void* message);

template <class Message>
std::vector<std::uint8_t> encode(const Message& message) {
  return serialize_message(&message,
                           rosidl_typesupport_cpp::get_message_type_support_handle<Message>());
}

template <class Message>
Message decode(std::span<const std::uint8_t> bytes) {
  Message message;
  deserialize_message(bytes, rosidl_typesupport_cpp::get_message_type_support_handle<Message>(),
                      &message);
  return message;
}

}  // namespace play_launch::control
