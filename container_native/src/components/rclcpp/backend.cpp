#include "components/rclcpp/backend.hpp"

#include <dlfcn.h>
#include <link.h>

#include <algorithm>
#include <class_loader/class_loader.hpp>
#include <exception>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <rclcpp/logger.hpp>
#include <rclcpp/logging.hpp>
#include <rclcpp/node_options.hpp>
#include <rclcpp/parameter.hpp>
#include <rclcpp_components/node_factory.hpp>
#include <rclcpp_components/node_instance_wrapper.hpp>
#include <string>
#include <utility>
#include <vector>

#include "base/elf.hpp"
#include "components/component_options.hpp"
#include "components/rclcpp/component.hpp"
#include "components/rclcpp/executor.hpp"
#include "overrides/rclcpp_functions.hpp"

namespace play_launch::rclcpp_backend {
namespace {

using container::Component;
using container::ComponentExecutor;
using container::ComponentOptions;
using container::LoadError;
using container::LoadRequest;
using rclcpp_components::NodeFactory;

/// rcl's name for the logger of a node.
std::string logger_name(const std::string& full_name) {
  std::string name = full_name.substr(1);
  std::ranges::replace(name, '/', '.');
  return name;
}

void set_log_level(const std::string& full_name, int level) {
  rclcpp::get_logger(logger_name(full_name)).set_level(static_cast<rclcpp::Logger::Level>(level));
}

std::vector<rclcpp::Parameter> parameters(const ComponentOptions& component) {
  std::vector<rclcpp::Parameter> result;
  result.reserve(component.parameters.size());
  for (const rcl_interfaces::msg::Parameter& message : component.parameters) {
    try {
      result.push_back(rclcpp::Parameter::from_parameter_msg(message));
    } catch (const std::exception& error) {
      throw LoadError("parameter '" + message.name + "': " + error.what());
    }
  }
  return result;
}

std::vector<std::string> arguments(const ComponentOptions& component) {
  std::vector<std::string> result{"--ros-args"};
  result.insert(result.end(), component.arguments.begin(), component.arguments.end());
  // After the remap rules: of several rules for a name the first one counts.
  if (!component.node_name.empty()) {
    result.insert(result.end(), {"-r", "__node:=" + component.node_name});
  }
  if (!component.node_namespace.empty()) {
    result.insert(result.end(), {"-r", "__ns:=" + component.node_namespace});
  }
  return result;
}

/// What rclcpp_components' ComponentManager makes of a request. Extra arguments that it does not
/// know are not looked at, like there.
rclcpp::NodeOptions node_options(const ComponentOptions& component) {
  if (component.forward_global_arguments) {
    RCLCPP_WARN(rclcpp::get_logger("component_container"),
                "forward_global_arguments: the arguments of the container, its name among them, "
                "now hold for the component as well");
  }
  return rclcpp::NodeOptions()
      .use_global_arguments(component.forward_global_arguments)
      .use_intra_process_comms(component.use_intra_process_comms)
      .parameter_overrides(parameters(component))
      .arguments(arguments(component));
}

class RclcppClass final : public container::ComponentClass {
 public:
  explicit RclcppClass(std::shared_ptr<NodeFactory> factory) : factory_(std::move(factory)) {}

  std::unique_ptr<Component> create(const LoadRequest& request) const override {
    const ComponentOptions component = container::component_options(request);
    const rclcpp::NodeOptions options = node_options(component);
    // Before the constructor logs anything, if the name is known.
    const std::optional<std::string> expected = container::expected_full_name(request);
    if (component.log_level != 0 && expected) {
      set_log_level(*expected, component.log_level);
    }
    rclcpp_components::NodeInstanceWrapper instance;
    try {
      instance = factory_->create_node_instance(options);
    } catch (...) {
      throw LoadError("the constructor of " + request.plugin_name + " threw " +
                      container::describe_current_exception());
    }
    auto made = std::make_unique<RclcppComponent>(std::move(instance));
    if (component.log_level != 0 && made->full_name() != expected) {
      set_log_level(made->full_name(), component.log_level);
    }
    return made;
  }

 private:
  const std::shared_ptr<NodeFactory> factory_;
};

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

/// Functions that a loaded library calls and no library defines, by their C++ names. class_loader
/// binds them when they are called, and the process ends when one is missing then.
std::vector<std::string> missing_functions(const std::string& path) {
  std::vector<std::string> missing;
  const std::unique_ptr<void, int (*)(void*)> library(
      ::dlopen(path.c_str(), RTLD_LAZY | RTLD_NOLOAD), ::dlclose);
  const link_map* map = nullptr;
  if (library != nullptr && ::dlinfo(library.get(), RTLD_DI_LINKMAP, &map) == 0) {
    DynamicSymbols(*map).for_each_undefined([&](const char* name) {
      if (::dlsym(RTLD_DEFAULT, name) == nullptr && ::dlsym(library.get(), name) == nullptr) {
        missing.push_back(demangled(name));
      }
    });
  }
  return missing;
}

/// Makes its factories in the container, as class_loader takes locks for that; no child does.
class RclcppLibrary final : public container::ComponentLibrary {
 public:
  explicit RclcppLibrary(const std::string& path) : path_(path) {
    // One loader for each library: with one for each load, the classes of a library were lost when
    // many were loaded from it at once.
    try {
      loader_ = std::make_unique<class_loader::ClassLoader>(path).release();
    } catch (const std::exception& error) {
      throw LoadError("cannot load library " + path + ": " + error.what());
    }
    missing_ = missing_functions(path);
  }

  const container::ComponentClass& find(const std::string& plugin) const override {
    const std::lock_guard lock(mutex_);
    const auto found = classes_.find(plugin);
    return found != classes_.end() ? found->second
                                   : classes_.try_emplace(plugin, factory(plugin)).first->second;
  }

 private:
  std::shared_ptr<NodeFactory> factory(const std::string& plugin) const {
    if (!missing_.empty()) {
      const std::size_t more = missing_.size() - 1;
      throw LoadError("cannot load library " + path_ + ": no library defines " + missing_.front() +
                      (more > 0 ? " and " + std::to_string(more) + " more functions" : "") +
                      " that it calls");
    }
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

  const std::string path_;
  /// Never destroyed, which would close the library.
  class_loader::ClassLoader* loader_ = nullptr;
  std::vector<std::string> missing_;  // see missing_functions()
  mutable std::mutex mutex_;          // guards what follows
  mutable std::map<std::string, RclcppClass> classes_;
};

}  // namespace

RclcppBackend::RclcppBackend(std::shared_ptr<Context> context) : context_(std::move(context)) {}

std::unique_ptr<container::ComponentLibrary> RclcppBackend::open(const std::string& path) {
  return std::make_unique<RclcppLibrary>(path);
}

std::unique_ptr<ComponentExecutor> RclcppBackend::create_executor(
    const container::ExecutorChoice& choice, std::shared_ptr<detail::StopFlag> stop) {
  return std::make_unique<NodeExecutor>(choice.multi_threaded ? choice.threads : 1,
                                        std::move(stop));
}

bool RclcppBackend::with_logging_lock(const std::function<void()>& function) {
  return rclcpp_backend::with_logging_lock(function);
}

}  // namespace play_launch::rclcpp_backend
