#include <dlfcn.h>

#include <algorithm>
#include <filesystem>
#include <play_launch/component_registry.hpp>

namespace play_launch {
namespace {

std::string canonical(const std::string& path) {
  std::error_code error;
  const auto resolved = std::filesystem::canonical(path, error);
  return error ? path : resolved.string();
}

std::string library_of(const void* address) {
  Dl_info info;
  if (dladdr(address, &info) == 0 || info.dli_fname == nullptr) return {};
  return canonical(info.dli_fname);
}

}  // namespace

ComponentRegistry& ComponentRegistry::instance() {
  // Never destroyed: libraries may be closed after static destructors have run.
  static auto* const registry = new ComponentRegistry();
  return *registry;
}

const ComponentFactory* ComponentRegistry::find(const std::string& class_name,
                                                const std::string& library) const {
  const std::string wanted = library.empty() ? library : canonical(library);
  const std::lock_guard lock(mutex_);
  const auto found =
      std::find_if(factories_.begin(), factories_.end(), [&](const auto& registered) {
        return registered.first.first == class_name &&
               (wanted.empty() || registered.first.second == wanted);
      });
  return found == factories_.end() ? nullptr : found->second;
}

std::vector<std::string> ComponentRegistry::names(const std::string& library) const {
  const std::string wanted = library.empty() ? library : canonical(library);
  std::vector<std::string> names;
  const std::lock_guard lock(mutex_);
  for (const auto& [key, factory] : factories_) {
    if (!wanted.empty() && key.second != wanted) continue;
    if (names.empty() || names.back() != key.first) names.push_back(key.first);
  }
  return names;
}

void ComponentRegistry::add(const std::string& class_name, const void* address,
                            const ComponentFactory* factory) {
  const std::string library = library_of(address);
  const std::lock_guard lock(mutex_);
  factories_[{class_name, library}] = factory;
}

void ComponentRegistry::remove(const ComponentFactory* factory) {
  const std::lock_guard lock(mutex_);
  std::erase_if(factories_, [factory](const auto& entry) { return entry.second == factory; });
}

}  // namespace play_launch
