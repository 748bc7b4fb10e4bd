#include "components/rclcpp/missing_symbols.hpp"

#include <cxxabi.h>
#include <dlfcn.h>
#include <link.h>

#include <cstdlib>
#include <memory>

#include "base/elf.hpp"

namespace play_launch::rclcpp_backend {
namespace {

struct CloseLibrary {
  void operator()(void* handle) const { ::dlclose(handle); }
};
using LibraryHandle = std::unique_ptr<void, CloseLibrary>;

bool is_there(void* library, const char* name) {
  return ::dlsym(RTLD_DEFAULT, name) != nullptr || ::dlsym(library, name) != nullptr;
}

std::string readable(const char* name) {
  int status = 0;
  const std::unique_ptr<char, decltype(&std::free)> text(
      abi::__cxa_demangle(name, nullptr, nullptr, &status), &std::free);
  return status == 0 ? text.get() : name;
}

}  // namespace

std::vector<std::string> missing_functions(const std::string& library) {
  std::vector<std::string> missing;
  const LibraryHandle handle(::dlopen(library.c_str(), RTLD_LAZY | RTLD_NOLOAD));
  const link_map* map = nullptr;
  if (handle == nullptr || ::dlinfo(handle.get(), RTLD_DI_LINKMAP, &map) != 0) {
    return missing;
  }
  DynamicSymbols(*map).for_each_import([&](const char* name) {
    if (!is_there(handle.get(), name)) {
      missing.push_back(readable(name));
    }
  });
  return missing;
}

}  // namespace play_launch::rclcpp_backend
