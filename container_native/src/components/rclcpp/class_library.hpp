#pragma once

#include <class_loader/class_loader.hpp>
#include <memory>
#include <rclcpp_components/node_factory.hpp>
#include <string>
#include <vector>

namespace play_launch::rclcpp_backend {

/// A library of components that is open. Stays so.
class ClassLibrary {
 public:
  /// Opens it. Throws LoadError.
  explicit ClassLibrary(const std::string& path);

  /// The factory for a class that is registered with RCLCPP_COMPONENTS_REGISTER_NODE. Any thread of
  /// the container: it takes locks of class_loader. Throws LoadError.
  std::shared_ptr<rclcpp_components::NodeFactory> factory(const std::string& plugin) const;

 private:
  void check_complete() const;

  const std::string path_;
  /// Never destroyed, which would close the library.
  class_loader::ClassLoader* loader_ = nullptr;
  std::vector<std::string> missing_;  // see missing_functions()
};

}  // namespace play_launch::rclcpp_backend
