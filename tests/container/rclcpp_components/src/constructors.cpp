#include <future>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <std_msgs/msg/string.hpp>
#include <stdexcept>

namespace test_components {

using std_msgs::msg::String;

/// Its constructor throws when the node is half made.
class ThrowingConstructor : public rclcpp::Node {
 public:
  explicit ThrowingConstructor(const rclcpp::NodeOptions& options)
      : Node("throwing_constructor", options) {
    throw std::runtime_error("no camera is connected");
  }
};

/// Wants to be told of the end of rclcpp.
class Watcher : public rclcpp::Node {
 public:
  explicit Watcher(const rclcpp::NodeOptions& options) : Node("watcher", options) {
    rclcpp::on_shutdown([this] { RCLCPP_INFO(get_logger(), "%s saw the end", get_name()); });
  }
};

namespace {

std::promise<void> released;

}  // namespace

/// Its callback on `go` says on `busy` that it has begun, waits for a Releaser, and says that it
/// ends.
class Patient : public rclcpp::Node {
 public:
  explicit Patient(const rclcpp::NodeOptions& options) : Node("patient", options) {
    publisher_ = create_publisher<String>("busy", 10);
    subscription_ = create_subscription<String>("go", 1, [this](const String&) { be_busy(); });
  }

 private:
  void be_busy() {
    String message;
    message.data = "begin";
    publisher_->publish(message);
    released.get_future().wait();
    message.data = "end";
    publisher_->publish(message);
  }

  rclcpp::Publisher<String>::SharedPtr publisher_;
  rclcpp::Subscription<String>::SharedPtr subscription_;
};

/// A message on `leave` releases the Patient of the same process.
class Releaser : public rclcpp::Node {
 public:
  explicit Releaser(const rclcpp::NodeOptions& options) : Node("releaser", options) {
    subscription_ =
        create_subscription<String>("leave", 1, [](const String&) { released.set_value(); });
  }

 private:
  rclcpp::Subscription<String>::SharedPtr subscription_;
};

}  // namespace test_components

RCLCPP_COMPONENTS_REGISTER_NODE(test_components::ThrowingConstructor)
RCLCPP_COMPONENTS_REGISTER_NODE(test_components::Patient)
RCLCPP_COMPONENTS_REGISTER_NODE(test_components::Releaser)
RCLCPP_COMPONENTS_REGISTER_NODE(test_components::Watcher)
