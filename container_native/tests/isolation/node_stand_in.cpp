#include "node_stand_in.hpp"

#include <mutex>

#include "busy.hpp"

namespace rclcpp {

std::shared_timed_mutex pointer_lock;

template <class Message>
[[gnu::noinline]] void publish_by_pointer(const Message& message) {
  const std::shared_lock guard(pointer_lock);
  busy(message);
}

}  // namespace rclcpp

namespace stand_in {

std::shared_timed_mutex& pointer_lock() { return rclcpp::pointer_lock; }

void compute_for_ever() { busy_for_ever(); }

void publish_by_pointer_for_ever() {
  while (true) {
    rclcpp::publish_by_pointer(5000);
    busy(1000);
  }
}

}  // namespace stand_in
