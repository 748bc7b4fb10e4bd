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

/// The type support that the middleware takes for what `type_support` describes, or that itself
/// when it cannot be found out. The latter one looks for the other each time, with the dynamic
/// loader's lock, which is held while a node's library is initialised. `example` is a message of
/// that type.
const rosidl_message_type_support_t* direct_type_support(
    const rosidl_message_type_support_t* type_support, const void* example);

/// Found when it is first asked for, see prepare_messages().
template <class Message>
const rosidl_message_type_support_t* type_support_of() {
  static const rosidl_message_type_support_t* const found = [] {
    const Message example;
    return direct_type_support(rosidl_typesupport_cpp::get_message_type_support_handle<Message>(),
                               &example);
  }();
  return found;
}

/// To be called before the first library of a component is opened, with all types that encode() and
/// decode() will get.
template <class... Messages>
void prepare_messages() {
  (type_support_of<Messages>(), ...);
}

template <class Message>
std::vector<std::uint8_t> encode(const Message& message) {
  return serialize_message(&message, type_support_of<Message>());
}

template <class Message>
Message decode(std::span<const std::uint8_t> bytes) {
  Message message;
  deserialize_message(bytes, type_support_of<Message>(), &message);
  return message;
}

}  // namespace play_launch::control
