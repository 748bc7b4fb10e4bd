#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

namespace play_launch::control {

/// What a frame carries; the payload is the play_launch_msgs message named beside it.
enum class FrameKind : std::uint16_t {
  hello = 1,     // ControlHello, both directions
  load = 2,      // ControlLoad, to the container
  accepted = 3,  // ControlAccepted, from the container
  rejected = 4,  // ControlRejected, from the container
  event = 5,     // ComponentEvent, from the container
  query = 6,     // ControlQuery, to the container
  status = 7,    // ControlStatus, from the container
  cancel = 8,    // ControlCancel, to the container
  unload = 9,    // ControlUnload, to the container
  shutdown = 10  // ControlShutdown, to the container
};

inline constexpr std::uint16_t kProtocolVersion = 1;

/// Largest value of the length field, in bytes.
inline constexpr std::uint32_t kMaxFrameLength = 16U * 1024U * 1024U;

/// The peer sent something that cannot be a frame or a message; the stream has lost its meaning.
class ProtocolError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// One frame as it came in; kind and version are kept as numbers because a newer peer may send
/// ones that this side does not know.
struct Frame {
  std::uint16_t kind = 0;
  std::uint16_t version = 0;
  std::vector<std::uint8_t> payload;
};

/// Bytes of one frame, ready to be sent.
/// Throws ProtocolError when the payload is larger than a frame can carry.
std::vector<std::uint8_t> encode_frame(FrameKind kind, std::span<const std::uint8_t> payload);

/// Cuts a byte stream into frames, whatever the sizes of the pieces in which it arrives.
class FrameDecoder {
 public:
  void feed(std::span<const std::uint8_t> bytes);

  /// The next whole frame, or nothing when more bytes are needed.
  /// Throws ProtocolError on an impossible length; the decoder is of no use afterwards.
  std::optional<Frame> next();

 private:
  std::size_t pending() const { return buffer_.size() - start_; }

  std::vector<std::uint8_t> buffer_;
  std::size_t start_ = 0;
};

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
