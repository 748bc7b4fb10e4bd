#include "components/rclcpp/class_library.hpp"

#include <algorithm>
#include <exception>
#include <utility>
#include <vector>

#include "components/component_options.hpp"
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

ClassLibrary::ClassLibrary(const std::string& path) : path_(path) {
  // One loader for each library: with one for each load, the classes of a library were lost when
  // many were loaded from it at once.
  try {
    loader_ = std::make_unique<class_loader::ClassLoader>(path).release();
  } catch (const std::exception& error) {
    throw LoadError("cannot load library " + path + ": " + error.what());
  }
  missing_ = missing_functions(path);
}

void ClassLibrary::check_complete() const {
  if (!missing_.empty()) {
    throw LoadError("cannot load library " + path_ + ": no library defines " + missing_.front() +
                    (missing_.size() > 1
                         ? " and " + std::to_string(missing_.size() - 1) + " more functions"
                         : "") +
                    " that it calls");
  }
}

std::shared_ptr<rclcpp_components::NodeFactory> ClassLibrary::factory(
    const std::string& plugin) const {
  using rclcpp_components::NodeFactory;
  check_complete();
  const std::vector<std::string> classes = loader_->getAvailableClasses<NodeFactory>();
  const std::string registered_as = kFactoryTemplate + plugin + ">";
  const auto found = std::ranges::find_if(
      classes, [&](const std::string& name) { return name == plugin || name == registered_as; });
  if (found == classes.end()) {
    throw LoadError("the index says that " + path_ + " has component '" + plugin +
                    "', but it registers " + listed(classes) +
                    "; is RCLCPP_COMPONENTS_REGISTER_NODE missing?");
  }
  try {
    return loader_->createInstance<NodeFactory>(*found);
  } catch (const std::exception& error) {
    throw LoadError("cannot make the factory of " + plugin + ": " + error.what());
  }
}

}  // namespace play_launch::rclcpp_backend
