#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <play_launch/context.hpp>
#include <play_launch/detail/stop_flag.hpp>
#include <string>
#include <utility>
#include <vector>

#include "components/component_options.hpp"

namespace play_launch::container {

/// Finds component classes in one resource type of the ament index. A resource has one line
/// "plugin::Class;library" per class; the library's path is absolute or relative to the prefix of
/// the resource.
class ComponentIndex {
 public:
  explicit ComponentIndex(std::string resource_type) : resource_type_(std::move(resource_type)) {}

  /// Whether the package has a resource of this type. Throws LoadError when there is no index.
  bool has_package(const std::string& package) const;

  /// Library that has the class `plugin`. Throws LoadError: the package or the class is not there
  /// (the text names what is), or a line cannot be read.
  std::filesystem::path library_of(const std::string& package, const std::string& plugin) const;

  const std::string& resource_type() const { return resource_type_; }

 private:
  const std::string resource_type_;
};

/// Why no backend knows `package`, and how to change that.
std::string no_such_package(const std::string& package, const std::vector<ComponentIndex>& indexes);

/// One component that was constructed. Destroying it destroys its node; it must not be in an
/// executor then. Belongs to the backend that made it.
class Component {
 public:
  Component() = default;
  Component(const Component&) = delete;
  Component& operator=(const Component&) = delete;
  virtual ~Component() = default;

  /// Fully qualified name of its node.
  virtual std::string full_name() const = 0;
};

/// What an executor notes of itself, in nanoseconds of the steady clock.
struct Beat {
  /// When it last came round; 0: never.
  std::atomic<std::int64_t> last{0};
  /// When the takes from the middleware began that are under way; 0: none.
  std::array<std::atomic<std::int64_t>, 8> takes{};
};

/// Runs the callbacks of components of one backend.
class ComponentExecutor {
 public:
  ComponentExecutor() = default;
  ComponentExecutor(const ComponentExecutor&) = delete;
  ComponentExecutor& operator=(const ComponentExecutor&) = delete;
  virtual ~ComponentExecutor() = default;

  /// Runs callbacks until the request to stop is made, and returns after those that run then. What
  /// a callback throws leaves it, and so ends the process.
  virtual void spin() = 0;
  virtual void add(Component& component) = 0;
  /// Returns when no callback of the component runs any more; none will run afterwards.
  virtual void remove(Component& component) = 0;
  /// For an executor whose spin() ran in a process that shares this memory and has died: releases
  /// the hold of the callbacks that were running, so that remove() and the destructor can do their
  /// work.
  virtual void abandon() = 0;
  /// Before spin(): from then on, the time is noted in `beat` whenever the executor comes round,
  /// and at least once a second unless every thread of it is in a callback. `beat` must outlive
  /// spin(). An executor that cannot do that leaves it as it is.
  virtual void beat_into(Beat& beat) = 0;
};

/// A component class in a library that is open. Never destroyed.
class ComponentClass {
 public:
  ComponentClass() = default;
  ComponentClass(const ComponentClass&) = delete;
  ComponentClass& operator=(const ComponentClass&) = delete;
  virtual ~ComponentClass() = default;

  /// Constructs a component, in the calling thread, which may be a child's. Throws LoadError.
  virtual std::unique_ptr<Component> create(const LoadRequest& request) const = 0;
};

/// A library of components that is open, and stays so.
class ComponentLibrary {
 public:
  ComponentLibrary() = default;
  ComponentLibrary(const ComponentLibrary&) = delete;
  ComponentLibrary& operator=(const ComponentLibrary&) = delete;
  virtual ~ComponentLibrary() = default;

  /// The class that is registered as `plugin`. Any thread of the container. Throws LoadError.
  virtual const ComponentClass& find(const std::string& plugin) const = 0;
};

struct ExecutorChoice {
  bool multi_threaded = false;
  std::size_t threads = 1;
  /// No number was requested: a node that may use other CPUs than the container has another one.
  bool by_cpus = false;
};

/// One kind of component: how its classes are found, made and run. All members may be called from
/// several threads at once.
class ComponentBackend {
 public:
  ComponentBackend() = default;
  ComponentBackend(const ComponentBackend&) = delete;
  ComponentBackend& operator=(const ComponentBackend&) = delete;
  virtual ~ComponentBackend() = default;

  /// The context that its nodes are made in. The container makes its own node in this one too, so
  /// that all share one participant.
  virtual std::shared_ptr<Context> context() = 0;

  virtual const ComponentIndex& index() const = 0;

  /// Opens a library. Its initialisers run in the calling thread, with the dynamic loader's lock.
  /// Once for each library, see LibraryLoader. Throws LoadError.
  virtual std::unique_ptr<ComponentLibrary> open(const std::string& path) = 0;

  /// `stop` is the request to stop, for this executor alone.
  virtual std::unique_ptr<ComponentExecutor> create_executor(
      const ExecutorChoice& choice, std::shared_ptr<detail::StopFlag> stop) = 0;

  /// Calls a function with the lock that guards rcl's table of the nodes that log to /rosout, where
  /// nodes of this backend use that. False: it could not be called.
  virtual bool with_logging_lock(const std::function<void()>& function) = 0;
};

}  // namespace play_launch::container
