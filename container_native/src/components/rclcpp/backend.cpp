#include "components/rclcpp/backend.hpp"

#include <algorithm>
#include <map>
#include <mutex>
#include <optional>
#include <rclcpp/logger.hpp>
#include <rclcpp_components/node_instance_wrapper.hpp>
#include <string>
#include <utility>

#include "components/component_options.hpp"
#include "components/rclcpp/class_library.hpp"
#include "components/rclcpp/component.hpp"
#include "components/rclcpp/executor.hpp"
#include "components/rclcpp/node_options.hpp"
#include "overrides/rclcpp_logging.hpp"

namespace play_launch::rclcpp_backend {
namespace {

using container::Component;
using container::ComponentExecutor;
using container::LoadError;
using container::LoadRequest;

/// rcl's name for the logger of a node.
std::string logger_name(const std::string& full_name) {
  std::string name = full_name.substr(1);
  std::ranges::replace(name, '/', '.');
  return name;
}

void set_log_level(const std::string& full_name, int level) {
  rclcpp::get_logger(logger_name(full_name)).set_level(static_cast<rclcpp::Logger::Level>(level));
}

class RclcppClass final : public container::ComponentClass {
 public:
  explicit RclcppClass(std::shared_ptr<rclcpp_components::NodeFactory> factory)
      : factory_(std::move(factory)) {}

  std::unique_ptr<Component> create(const LoadRequest& request) const override {
    const container::ComponentOptions component = container::component_options(request);
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
  const std::shared_ptr<rclcpp_components::NodeFactory> factory_;
};

class RclcppLibrary final : public container::ComponentLibrary {
 public:
  explicit RclcppLibrary(const std::string& path) : library_(path) {}

  const container::ComponentClass& find(const std::string& plugin) const override {
    const std::lock_guard lock(mutex_);
    const auto found = classes_.find(plugin);
    return found != classes_.end()
               ? found->second
               : classes_.try_emplace(plugin, library_.factory(plugin)).first->second;
  }

 private:
  const ClassLibrary library_;
  mutable std::mutex mutex_;  // guards what follows; no child takes it
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
