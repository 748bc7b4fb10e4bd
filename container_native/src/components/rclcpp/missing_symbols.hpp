#pragma once

#include <string>
#include <vector>

namespace play_launch::rclcpp_backend {

/// Functions that a loaded library calls and no library defines, by their C++ names. class_loader
/// binds them when they are called, and the process ends when one is missing then. Empty, too, when
/// the library is not loaded.
std::vector<std::string> missing_functions(const std::string& library);

}  // namespace play_launch::rclcpp_backend
