#pragma once

#include <class_loader/class_loader.hpp>
#include <map>
#include <memory>
#include <mutex>
#include <rclcpp_components/node_factory.hpp>
#include <string>
#include <vector>

namespace play_launch::rclcpp_backend {

/// The libraries of components that were loaded so far. All members may be called from several
/// threads at once.
class ClassLibraries {
 public:
  /// The factory for a class that is registered with RCLCPP_COMPONENTS_REGISTER_NODE in a library,
  /// which is loaded if it is not yet. Throws LoadError.
  std::shared_ptr<rclcpp_components::NodeFactory> factory(const std::string& library,
                                                          const std::string& plugin);

 private:
  class_loader::ClassLoader& loader(const std::string& library);
  void check_complete(const std::string& library);

  std::mutex mutex_;
  /// Never destroyed, so that libraries stay loaded: code of a library may be needed until the
  /// process ends, for example by a message's deleter, a thread_local or a handler it registered.
  std::map<std::string, class_loader::ClassLoader*> loaders_;
  std::map<std::string, std::vector<std::string>> missing_;  // see missing_functions()
};

}  // namespace play_launch::rclcpp_backend
