#include <unistd.h>

#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <sstream>
#include <std_msgs/msg/string.hpp>

namespace test_components {

/// Has every parameter that it is given, and publishes on `options` (latched for late readers) what
/// options it was made with.
class Options : public rclcpp::Node {
 public:
  explicit Options(const rclcpp::NodeOptions& options)
      : Node("options", rclcpp::NodeOptions(options)
                            .allow_undeclared_parameters(true)
                            .automatically_declare_parameters_from_overrides(true)) {
    rclcpp::PublisherOptions by_middleware;  // which keeps it for late readers
    by_middleware.use_intra_process_comm = rclcpp::IntraProcessSetting::Disable;
    publisher_ = create_publisher<std_msgs::msg::String>(
        "options", rclcpp::QoS(1).transient_local(), by_middleware);
    std::ostringstream text;
    text << "intra_process=" << options.use_intra_process_comms()
         << " global=" << options.use_global_arguments()
         << " debug=" << (get_logger().get_effective_level() == rclcpp::Logger::Level::Debug)
         << " pid=" << ::getpid();
    std_msgs::msg::String message;
    message.data = text.str();
    publisher_->publish(message);
  }

 private:
  rclcpp::Publisher<std_msgs::msg::String>::SharedPtr publisher_;
};

/// Is made without its options, and so of the global arguments: it has the name of its container.
class WithoutOptions : public rclcpp::Node {
 public:
  explicit WithoutOptions(const rclcpp::NodeOptions&) : Node("without_options") {}
};

}  // namespace test_components

RCLCPP_COMPONENTS_REGISTER_NODE(test_components::WithoutOptions)
RCLCPP_COMPONENTS_REGISTER_NODE(test_components::Options)
