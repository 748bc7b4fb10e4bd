#include "control/frames.hpp"

#include <rcutils/allocator.h>
#include <rmw/error_handling.h>
#include <rmw/rmw.h>
#include <rmw/serialized_message.h>
#include <rosidl_runtime_c/message_type_support_struct.h>

#include <exception>
#include <stdexcept>
#include <string>

namespace play_launch::control {
namespace {

/// Bytes of the length field, and of kind and version behind it.
constexpr std::size_t kLengthSize = 4;
constexpr std::size_t kHeadSize = 4;

void put_le(std::vector<std::uint8_t>& out, std::uint32_t value, std::size_t bytes) {
  for (std::size_t i = 0; i < bytes; ++i) {
    out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
  }
}

std::uint32_t get_le(const std::uint8_t* in, std::size_t bytes) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < bytes; ++i) {
    value |= static_cast<std::uint32_t>(in[i]) << (8 * i);
  }
  return value;
}

}  // namespace

std::vector<std::uint8_t> encode_frame(FrameKind kind, std::span<const std::uint8_t> payload) {
  if (payload.size() > kMaxFrameLength - kHeadSize) {
    throw ProtocolError("a message of " + std::to_string(payload.size()) +
                        " bytes does not fit into a frame (limit " +
                        std::to_string(kMaxFrameLength) + ")");
  }
  std::vector<std::uint8_t> out;
  out.reserve(kLengthSize + kHeadSize + payload.size());
  put_le(out, static_cast<std::uint32_t>(kHeadSize + payload.size()), 4);
  put_le(out, static_cast<std::uint16_t>(kind), 2);
  put_le(out, kProtocolVersion, 2);
  out.insert(out.end(), payload.begin(), payload.end());
  return out;
}

void FrameDecoder::feed(std::span<const std::uint8_t> bytes) {
  // What was handed out already goes only now, so that next() never moves memory.
  buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(start_));
  start_ = 0;
  buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
}

std::optional<Frame> FrameDecoder::next() {
  if (pending() < kLengthSize) {
    return std::nullopt;
  }
  const std::uint8_t* head = buffer_.data() + start_;
  const std::uint32_t length = get_le(head, 4);
  if (length < kHeadSize || length > kMaxFrameLength) {
    throw ProtocolError("frame length " + std::to_string(length) + " is outside of " +
                        std::to_string(kHeadSize) + " to " + std::to_string(kMaxFrameLength));
  }
  if (pending() < kLengthSize + length) {
    return std::nullopt;
  }
  Frame frame;
  frame.kind = static_cast<std::uint16_t>(get_le(head + 4, 2));
  frame.version = static_cast<std::uint16_t>(get_le(head + 6, 2));
  const std::uint8_t* payload = head + kLengthSize + kHeadSize;
  frame.payload.assign(payload, payload + (length - kHeadSize));
  start_ += kLengthSize + length;
  return frame;
}

namespace {

std::string take_rmw_error() {
  std::string text = rmw_error_is_set() ? rmw_get_error_string().str : "unknown error";
  rmw_reset_error();
  return text;
}

class SerializedMessage {
 public:
  SerializedMessage() : message_(rmw_get_zero_initialized_serialized_message()) {
    const rcutils_allocator_t allocator = rcutils_get_default_allocator();
    if (rmw_serialized_message_init(&message_, 0, &allocator) != RMW_RET_OK) {
      throw std::runtime_error("no memory for a serialized message: " + take_rmw_error());
    }
  }
  SerializedMessage(const SerializedMessage&) = delete;
  SerializedMessage& operator=(const SerializedMessage&) = delete;
  ~SerializedMessage() {
    if (rmw_serialized_message_fini(&message_) != RMW_RET_OK) {
      rmw_reset_error();
    }
  }

  rmw_serialized_message_t* get() { return &message_; }

 private:
  rmw_serialized_message_t message_;
};

}  // namespace

const rosidl_message_type_support_t* direct_type_support(
    const rosidl_message_type_support_t* type_support, const void* example) {
  // Tried out instead of known for each middleware: Fast DDS takes the first, CycloneDDS the
  // second.
  for (const char* const identifier :
       {"rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_cpp"}) {
    const rosidl_message_type_support_t* const direct =
        get_message_typesupport_handle(type_support, identifier);
    SerializedMessage serialized;
    const bool works =
        direct != nullptr && rmw_serialize(example, direct, serialized.get()) == RMW_RET_OK;
    rmw_reset_error();  // also what finding the handle left
    if (works) {
      return direct;
    }
  }
  return type_support;
}

std::vector<std::uint8_t> serialize_message(const void* message,
                                            const rosidl_message_type_support_t* type_support) {
  SerializedMessage serialized;
  if (rmw_serialize(message, type_support, serialized.get()) != RMW_RET_OK) {
    throw std::runtime_error("cannot serialize a message: " + take_rmw_error());
  }
  const rmw_serialized_message_t& bytes = *serialized.get();
  return {bytes.buffer, bytes.buffer + bytes.buffer_length};
}

void deserialize_message(std::span<const std::uint8_t> bytes,
                         const rosidl_message_type_support_t* type_support, void* message) {
  // rmw reads only, but its signature has no const: lend it the bytes instead of copying them.
  rmw_serialized_message_t view = rmw_get_zero_initialized_serialized_message();
  view.buffer = const_cast<std::uint8_t*>(bytes.data());
  view.buffer_length = bytes.size();
  view.buffer_capacity = bytes.size();
  view.allocator = rcutils_get_default_allocator();
  try {
    if (rmw_deserialize(&view, type_support, message) == RMW_RET_OK) {
      return;
    }
  } catch (const std::exception& error) {
    // The middleware lets some errors of damaged input through, for example std::bad_alloc for
    // an absurd length.
    rmw_reset_error();
    throw ProtocolError(std::string("cannot read a message: ") + error.what());
  }
  throw ProtocolError("cannot read a message: " + take_rmw_error());
}

}  // namespace play_launch::control
