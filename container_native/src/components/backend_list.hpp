#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "components/component_backend.hpp"

namespace play_launch::container {

/// The kinds of components that a host can load. All members may be called from several threads at
/// once.
class BackendList {
 public:
  explicit BackendList(std::vector<std::unique_ptr<ComponentBackend>> backends)
      : backends_(std::move(backends)) {}

  std::size_t size() const { return backends_.size(); }
  ComponentBackend& operator[](std::size_t index) const { return *backends_[index]; }

  /// Index of the backend whose components the package has; reads files. Throws LoadError when
  /// there is none.
  std::size_t of_package(const std::string& package) const;

  /// Full name that the node will have, as far as all backends agree on it.
  std::optional<std::string> expected_full_name(const LoadRequest& request) const;

 private:
  const std::vector<std::unique_ptr<ComponentBackend>> backends_;
};

}  // namespace play_launch::container
