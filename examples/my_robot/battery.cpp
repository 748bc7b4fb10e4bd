#include <memory>
#include <play_launch/component.hpp>
#include <std_msgs/msg/float64.hpp>

namespace my_robot {

class Battery : public play_launch::Node {
 public:
  explicit Battery(const play_launch::NodeOptions& options) : Node("battery", options) {
    voltage_ = declare_parameter<double>("voltage", 24.0);
    publisher_ = create_publisher<std_msgs::msg::Float64>("voltage");
    timer_ = create_timer(std::chrono::milliseconds(100), [this] {
      std_msgs::msg::Float64 message;
      message.data = voltage_;
      publisher_->publish(message);
    });
    PLAY_LAUNCH_INFO(logger(), "battery at %.1f V", voltage_);
  }

 private:
  double voltage_ = 0.0;
  std::shared_ptr<play_launch::Publisher<std_msgs::msg::Float64>> publisher_;
  std::shared_ptr<play_launch::Timer> timer_;
};

}  // namespace my_robot

PLAY_LAUNCH_REGISTER_COMPONENT(my_robot::Battery)
