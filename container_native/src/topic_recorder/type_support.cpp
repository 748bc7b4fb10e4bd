#include "topic_recorder/type_support.hpp"

#include <dlfcn.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <ranges>
#include <stdexcept>
#include <string_view>

namespace play_launch::topics {
namespace {

/// The type comes from another process.
bool is_identifier(std::string_view text) {
  return !text.empty() && std::ranges::all_of(text, [](unsigned char each) {
    return std::isalnum(each) != 0 || each == '_';
  });
}

std::string installed(const std::string& library) {
  const char* const prefixes = std::getenv("AMENT_PREFIX_PATH");
  for (const auto part :
       std::string_view(prefixes == nullptr ? "" : prefixes) | std::views::split(':')) {
    const std::string prefix(part.begin(), part.end());
    std::string path = prefix + "/lib/" + library;
    if (!prefix.empty() && ::access(path.c_str(), R_OK) == 0) {
      return path;
    }
  }
  return library;
}

}  // namespace

const rosidl_message_type_support_t* message_type_support(const std::string& type) {
  const std::size_t first = type.find('/');
  const std::size_t last = type.rfind('/');
  if (first == std::string::npos || first == last) {
    throw std::runtime_error("it is not the name of a type");
  }
  const std::string package = type.substr(0, first);
  const std::string folder = type.substr(first + 1, last - first - 1);
  const std::string name = type.substr(last + 1);
  if (!is_identifier(package) || !is_identifier(folder) || !is_identifier(name)) {
    throw std::runtime_error("it is not the name of a type");
  }
  const std::string path = installed("lib" + package + "__rosidl_typesupport_c.so");
  void* const library = ::dlopen(path.c_str(), RTLD_LAZY | RTLD_LOCAL);
  if (library == nullptr) {
    throw std::runtime_error(::dlerror());
  }
  const std::string symbol = "rosidl_typesupport_c__get_message_type_support_handle__" + package +
                             "__" + folder + "__" + name;
  using Function = const rosidl_message_type_support_t* (*)();
  const auto function = reinterpret_cast<Function>(::dlsym(library, symbol.c_str()));
  if (function == nullptr) {
    throw std::runtime_error("it is not in " + path);
  }
  const rosidl_message_type_support_t* const found = function();
  if (found == nullptr) {
    throw std::runtime_error(path + " has no type support for it");
  }
  return found;
}

}  // namespace play_launch::topics
