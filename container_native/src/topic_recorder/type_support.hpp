#pragma once

#include <rosidl_runtime_c/message_type_support_struct.h>

#include <string>

namespace play_launch::topics {

/// The type support in C of `package/msg/Name`, from the first prefix of AMENT_PREFIX_PATH that has
/// its library, else from wherever the loader finds it. The library stays loaded. Throws
/// std::runtime_error with the reason.
const rosidl_message_type_support_t* message_type_support(const std::string& type);

}  // namespace play_launch::topics
