#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace play_launch::container {

/// Finds component classes in one resource type of the ament index. A resource has one line
/// "plugin::Class;library" per class; the library's path is absolute or relative to the prefix of
/// the resource.
class ComponentIndex {
 public:
  explicit ComponentIndex(std::string resource_type) : resource_type_(std::move(resource_type)) {}

  /// Whether the package has a resource of this type. Throws LoadError when there is no index.
  bool has_package(const std::string& package) const;

  /// Packages with a resource of this type, sorted.
  std::vector<std::string> packages() const;

  /// Library that has the class `plugin`. Throws LoadError: the package or the class is not there
  /// (the text names what is), or a line cannot be read.
  std::filesystem::path library_of(const std::string& package, const std::string& plugin) const;

  const std::string& resource_type() const { return resource_type_; }

 private:
  const std::string resource_type_;
};

/// One entry of a resource: class and library.
using IndexEntry = std::pair<std::string, std::string>;

/// The lines of a resource; empty lines are skipped. Throws LoadError naming a line that has not
/// the form "class;library".
std::vector<IndexEntry> parse_component_resource(const std::string& content);

/// Why no backend knows `package`: where was looked, what is there, and how to change that.
std::string no_such_package(const std::string& package, const std::vector<ComponentIndex>& indexes);

}  // namespace play_launch::container
