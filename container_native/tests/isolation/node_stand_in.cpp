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

namespace {

void compute_for_ever() { busy_for_ever(); }

void publish_by_pointer_for_ever() {
  while (true) {
    rclcpp::publish_by_pointer(5000);
    busy(1000);
  }
}

std::shared_timed_mutex& pointer_lock() { return rclcpp::pointer_lock; }

}  // namespace

extern "C" const stand_in::NodeLibrary play_launch_test_node{
    compute_for_ever, publish_by_pointer_for_ever, pointer_lock};
