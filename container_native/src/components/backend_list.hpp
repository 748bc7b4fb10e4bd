#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "components/component_backend.hpp"
#include "components/library_loader.hpp"

namespace play_launch::container {

/// The kinds of components that a host can load, in one context. Copies share the backends, and
/// with them the libraries that are open. All members may be called from several threads at once.
class BackendList {
 public:
  /// Never empty.
  explicit BackendList(std::vector<std::unique_ptr<ComponentBackend>> backends)
      : shared_(std::make_shared<Shared>(std::move(backends))) {}

  /// The context that all nodes are made in.
  std::shared_ptr<Context> context() const { return shared_->backends.front()->context(); }
  std::size_t size() const { return shared_->backends.size(); }
  ComponentBackend& operator[](std::size_t index) const { return *shared_->backends[index]; }

  /// What a request asks for, found in the index: reads files. Throws LoadError.
  struct Place {
    std::size_t backend = 0;
    std::string library;  // path
  };
  Place place_of(const std::string& package, const std::string& plugin) const;

  /// What a request asks for, ready to be constructed.
  struct Found {
    std::size_t backend = 0;
    const ComponentClass* component_class = nullptr;
  };
  /// Finds the component, and waits until its library is open. In a thread of the container that
  /// may wait, see LibraryLoader. Throws LoadError.
  Found find(std::uint64_t unique_id, const LoadRequest& request) const;

  /// What a node waits for while find() does; empty when it does not.
  std::string wait_of(std::uint64_t unique_id) const;

 private:
  struct Shared {
    explicit Shared(std::vector<std::unique_ptr<ComponentBackend>> all)
        : backends(std::move(all)) {}

    const std::vector<std::unique_ptr<ComponentBackend>> backends;
    LibraryLoader loader;
  };

  std::size_t of_package(const std::string& package) const;

  std::shared_ptr<Shared> shared_;
};

}  // namespace play_launch::container
