#include "components/rclcpp/missing_symbols.hpp"

#include <dlfcn.h>
#include <link.h>

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
      missing.push_back(demangled(name));
    }
  });
  return missing;
}

}  // namespace play_launch::rclcpp_backend
