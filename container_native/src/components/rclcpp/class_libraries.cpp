#include "components/rclcpp/class_libraries.hpp"

#include <algorithm>
#include <exception>
#include <utility>
#include <vector>

#include "components/load_request.hpp"
#include "components/rclcpp/missing_symbols.hpp"

namespace play_launch::rclcpp_backend {
namespace {

using container::LoadError;

constexpr const char* kFactoryTemplate = "rclcpp_components::NodeFactoryTemplate<";

std::string listed(const std::vector<std::string>& classes) {
  const std::string prefix = kFactoryTemplate;
  std::string text;
  for (const std::string& name : classes) {
    const bool wrapped = name.starts_with(prefix) && name.ends_with('>');
    text += (text.empty() ? "" : ", ") +
            (wrapped ? name.substr(prefix.size(), name.size() - prefix.size() - 1) : name);
  }
  return text.empty() ? "none" : "only " + text;
}

}  // namespace

class_loader::ClassLoader& ClassLibraries::loader(const std::string& library) {
  // One at a time, as in class_loader itself; and one loader for each library: with one for each
  // load, the classes of a library were lost when many were loaded from it at once.
  const std::lock_guard lock(mutex_);
  const auto found = loaders_.find(library);
  if (found != loaders_.end()) {
    return *found->second;
  }
  std::unique_ptr<class_loader::ClassLoader> made;
  try {
    made = std::make_unique<class_loader::ClassLoader>(library);
  } catch (const std::exception& error) {
    throw LoadError("cannot load library " + library + ": " + error.what());
  }
  class_loader::ClassLoader& loader = *loaders_.emplace(library, made.release()).first->second;
  missing_.emplace(library, missing_functions(library));
  return loader;
}

void ClassLibraries::check_complete(const std::string& library) {
  const std::lock_guard lock(mutex_);
  const std::vector<std::string>& missing = missing_[library];
  if (!missing.empty()) {
    throw LoadError("cannot load library " + library + ": nobody has " + missing.front() +
                    (missing.size() > 1
                         ? " and " + std::to_string(missing.size() - 1) + " more functions"
                         : "") +
                    " that it calls");
  }
}

std::shared_ptr<rclcpp_components::NodeFactory> ClassLibraries::factory(const std::string& library,
                                                                        const std::string& plugin) {
  using rclcpp_components::NodeFactory;
  class_loader::ClassLoader& loader = this->loader(library);
  check_complete(library);
  const std::vector<std::string> classes = loader.getAvailableClasses<NodeFactory>();
  const std::string registered_as = kFactoryTemplate + plugin + ">";
  const auto found = std::ranges::find_if(
      classes, [&](const std::string& name) { return name == plugin || name == registered_as; });
  if (found == classes.end()) {
    throw LoadError("the index says that " + library + " has component '" + plugin +
                    "', but it registers " + listed(classes) +
                    "; is RCLCPP_COMPONENTS_REGISTER_NODE missing?");
  }
  try {
    return loader.createInstance<NodeFactory>(*found);
  } catch (const std::exception& error) {
    throw LoadError("cannot make the factory of " + plugin + ": " + error.what());
  }
}

}  // namespace play_launch::rclcpp_backend
