#include <chrono>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <std_msgs/msg/string.hpp>
#include <string>

namespace test_components {

/// Publishes a number on `chatter`, `rate` times a second.
class Talker : public rclcpp::Node {
 public:
  explicit Talker(const rclcpp::NodeOptions& options) : Node("talker", options) {
    publisher_ = create_publisher<std_msgs::msg::String>("chatter", 10);
    const double rate = declare_parameter("rate", 100.0);
    timer_ = create_wall_timer(std::chrono::duration<double>(1.0 / rate), [this] { talk(); });
  }

 private:
  void talk() {
    std_msgs::msg::String message;
    message.data = std::to_string(count_++);
    publisher_->publish(message);
    RCLCPP_DEBUG(get_logger(), "said %s", message.data.c_str());
  }

  rclcpp::Publisher<std_msgs::msg::String>::SharedPtr publisher_;
  rclcpp::TimerBase::SharedPtr timer_;
  std::size_t count_ = 0;
};

}  // namespace test_components

RCLCPP_COMPONENTS_REGISTER_NODE(test_components::Talker)
