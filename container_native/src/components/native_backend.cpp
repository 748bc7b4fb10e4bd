#include "components/native_backend.hpp"

#include <dlfcn.h>

#include <map>
#include <play_launch/component_registry.hpp>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/executor.hpp>
#include <play_launch/node.hpp>
#include <utility>

#include "components/component_options.hpp"

namespace play_launch::container {
namespace {

class NativeComponent final : public Component {
 public:
  explicit NativeComponent(std::shared_ptr<Node> node) : node_(std::move(node)) {}
  std::string full_name() const override { return node_->full_name(); }
  const std::shared_ptr<Node>& node() const { return node_; }

 private:
  const std::shared_ptr<Node> node_;
};

/// The SDK cannot know the container's interface: this is what lies between.
class NativeExecutor final : public ComponentExecutor {
 public:
  explicit NativeExecutor(std::unique_ptr<Executor> executor) : executor_(std::move(executor)) {}
  void spin() override { executor_->spin(); }
  void add(Component& component) override { executor_->add_node(node_of(component)); }
  void remove(Component& component) override { executor_->remove_node(node_of(component)); }
  void abandon() override { detail::ExecutorAccess::abandon(*executor_); }
  void beat_into(Beat& beat) override {
    detail::ExecutorAccess::beat_into(*executor_, beat.last, beat.takes);
  }

 private:
  static const std::shared_ptr<Node>& node_of(Component& component) {
    return static_cast<NativeComponent&>(component).node();
  }

  const std::unique_ptr<Executor> executor_;
};

NodeOptions node_options(const LoadRequest& request, std::shared_ptr<Context> context) {
  const ComponentOptions component = component_options(request);
  NodeOptions options;
  options.context = std::move(context);
  options.arguments = component.arguments;
  options.use_global_arguments = component.forward_global_arguments;
  options.use_intra_process_comms = component.use_intra_process_comms;
  options.log_level = component.log_level;
  options.parameter_overrides = from_messages(component.parameters);
  options.extra_arguments = from_messages(component.extra_arguments);
  options.name = component.node_name;
  options.name_space = component.node_namespace;
  return options;
}

class NativeClass final : public ComponentClass {
 public:
  NativeClass(const ComponentFactory& factory, std::shared_ptr<Context> context)
      : factory_(factory), context_(std::move(context)) {}

  std::unique_ptr<Component> create(const LoadRequest& request) const override {
    const NodeOptions options = node_options(request, context_);
    std::shared_ptr<Node> node;
    try {
      node = factory_.create(options);
    } catch (...) {
      throw LoadError("the constructor of " + request.plugin_name + " threw " +
                      describe_current_exception());
    }
    return std::make_unique<NativeComponent>(std::move(node));
  }

 private:
  const ComponentFactory& factory_;
  const std::shared_ptr<Context> context_;
};

/// Takes what it registered out of the registry when it is opened, so that nodes' processes need no
/// lock to find it.
class NativeLibrary final : public ComponentLibrary {
 public:
  NativeLibrary(const std::string& path, const std::shared_ptr<Context>& context) : path_(path) {
    const ComponentRegistry& registry = ComponentRegistry::instance();
    for (const std::string& name : registry.names(path)) {
      classes_.try_emplace(name, *registry.find(name, path), context);
    }
  }

  const ComponentClass& find(const std::string& plugin) const override {
    const auto found = classes_.find(plugin);
    if (found != classes_.end()) {
      return found->second;
    }
    std::string known;
    for (const auto& [name, component_class] : classes_) {
      known += (known.empty() ? "" : ", ") + name;
    }
    throw LoadError("the index says that " + path_ + " has component '" + plugin +
                    "', but it registers " + (known.empty() ? "none" : "only " + known) +
                    "; is PLAY_LAUNCH_REGISTER_COMPONENT missing?");
  }

 private:
  const std::string path_;
  std::map<std::string, NativeClass> classes_;
};

}  // namespace

NativeBackend::NativeBackend(std::shared_ptr<Context> context) : context_(std::move(context)) {}

std::unique_ptr<ComponentLibrary> NativeBackend::open(const std::string& path) {
  // What its static initialisers throw ends the process; it cannot pass the loader.
  if (::dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL) == nullptr) {
    const char* const why = ::dlerror();
    throw LoadError("cannot load library " + path + ": " + (why != nullptr ? why : "no reason"));
  }
  return std::make_unique<NativeLibrary>(path, context_);
}

std::unique_ptr<ComponentExecutor> NativeBackend::create_executor(
    const ExecutorChoice& choice, std::shared_ptr<detail::StopFlag> stop) {
  if (choice.multi_threaded) {
    return std::make_unique<NativeExecutor>(
        detail::ExecutorAccess::multi_threaded(choice.threads, std::move(stop)));
  }
  return std::make_unique<NativeExecutor>(detail::ExecutorAccess::single_threaded(std::move(stop)));
}

}  // namespace play_launch::container
