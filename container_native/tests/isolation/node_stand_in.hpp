#pragma once

#include <shared_mutex>

/// A node's library.
namespace stand_in {

/// Loops in the node's own code for ever.
[[noreturn]] void compute_for_ever();
/// Publishes by pointer for ever: through a template of rclcpp's that became code of this library,
/// and that holds the lock below most of the time.
[[noreturn]] void publish_by_pointer_for_ever();
std::shared_timed_mutex& pointer_lock();

}  // namespace stand_in
