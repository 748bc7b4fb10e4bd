#pragma once

#include <functional>
#include <memory>
#include <play_launch/context.hpp>
#include <string>

namespace play_launch {

/// Keeps code of nodes from shutting the ROS context down, which belongs to all nodes and to the
/// container: in an isolated node such a call ends that node alone, anywhere else the container is
/// asked to stop. It is one object, as rcl_shutdown() has no other way to find it.
class ContextGuard {
 public:
  /// The caller, for messages: the node's full name, or the library when that is not known.
  using OnShutdown = std::function<void(const std::string& caller)>;

  /// `on_shutdown` is called in the thread that wants to shut the context down, outside of isolated
  /// nodes.
  ContextGuard(std::shared_ptr<Context> context, OnShutdown on_shutdown);
  /// From now on the context can be shut down. No node may be left.
  ~ContextGuard();
  ContextGuard(const ContextGuard&) = delete;
  ContextGuard& operator=(const ContextGuard&) = delete;

 private:
  const std::shared_ptr<Context> context_;
};

}  // namespace play_launch
