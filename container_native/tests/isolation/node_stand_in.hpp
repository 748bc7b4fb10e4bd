#pragma once

#include <shared_mutex>

namespace stand_in {

/// What a node's library does.
struct NodeLibrary {
  /// Loops in the node's own code without end.
  void (*compute_for_ever)();
  /// Publishes by pointer without end: through a template of rclcpp's that became code of the
  /// library, and that holds the lock below most of the time.
  void (*publish_by_pointer_for_ever)();
  std::shared_timed_mutex& (*pointer_lock)();
};

/// Opens it the first time, as libraries of nodes are: after the container has noted what was there
/// before.
const NodeLibrary& node_library();

}  // namespace stand_in
