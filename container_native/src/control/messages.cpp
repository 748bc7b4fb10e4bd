#include "control/messages.hpp"

#include <rcutils/allocator.h>
#include <rmw/error_handling.h>
#include <rmw/rmw.h>
#include <rmw/serialized_message.h>
#include <rosidl_runtime_c/message_type_support_struct.h>

#include <exception>
#include <stdexcept>
#include <string>

#include "control/frame_codec.hpp"

namespace play_launch::control {
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
