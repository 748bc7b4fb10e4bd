#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <play_launch/node.hpp>
#include <play_launch/node_options.hpp>
#include <string>
#include <utility>
#include <vector>

namespace play_launch {

/// Makes nodes of one component class.
class ComponentFactory {
 public:
  ComponentFactory() = default;
  virtual ~ComponentFactory() = default;
  ComponentFactory(const ComponentFactory&) = delete;
  ComponentFactory& operator=(const ComponentFactory&) = delete;

  /// Runs the component's constructor and lets out what it throws.
  [[nodiscard]] virtual std::shared_ptr<Node> create(const NodeOptions& options) const = 0;
};

/// The component classes of all libraries that are loaded into this process. Filled by the
/// libraries' static initialisers and emptied again when they are closed. Any thread.
class ComponentRegistry {
 public:
  static ComponentRegistry& instance();

  /// The factory for `class_name` ("ns::Class") in the library of that path, or in any library if
  /// the path is empty. Null if no class matches. Paths are compared after resolving links. Valid
  /// until the library is closed.
  [[nodiscard]] const ComponentFactory* find(const std::string& class_name,
                                             const std::string& library = {}) const;

  /// Names of the component classes in that library, or in all if the path is empty; sorted.
  [[nodiscard]] std::vector<std::string> names(const std::string& library = {}) const;

  /// Used by ComponentRegistration. `address` lies in the component's library.
  void add(const std::string& class_name, const void* address, const ComponentFactory* factory);
  void remove(const ComponentFactory* factory);

 private:
  ComponentRegistry() = default;

  mutable std::mutex mutex_;
  std::map<std::pair<std::string, std::string>, const ComponentFactory*> factories_;
};

/// Registers component class T for as long as the object lives; see the macro below.
template <class T>
class ComponentRegistration final : public ComponentFactory {
 public:
  explicit ComponentRegistration(const char* class_name) {
    ComponentRegistry::instance().add(class_name, this, this);
  }
  ~ComponentRegistration() override { ComponentRegistry::instance().remove(this); }

  [[nodiscard]] std::shared_ptr<Node> create(const NodeOptions& options) const override {
    return std::make_shared<T>(options);
  }
};

}  // namespace play_launch

#define PLAY_LAUNCH_DETAIL_JOIN(a, b) PLAY_LAUNCH_DETAIL_JOIN_AGAIN(a, b)
#define PLAY_LAUNCH_DETAIL_JOIN_AGAIN(a, b) a##b

/// Makes a class a loadable component. Once per class, in a source file of the library, at
/// namespace scope, with the fully qualified name: PLAY_LAUNCH_REGISTER_COMPONENT(demo::Talker).
/// The class derives from play_launch::Node and has a constructor Talker(const NodeOptions&).
#define PLAY_LAUNCH_REGISTER_COMPONENT(Class)                                \
  namespace {                                                                \
  const ::play_launch::ComponentRegistration<Class> PLAY_LAUNCH_DETAIL_JOIN( \
      play_launch_component_, __COUNTER__){#Class};                          \
  }
