#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>

namespace play_launch_rclcpp_test {

int defined_nowhere();

class Unresolved : public rclcpp::Node {
 public:
  explicit Unresolved(const rclcpp::NodeOptions& options) : Node("unresolved", options) {
    declare_parameter("number", defined_nowhere());
  }
};

}  // namespace play_launch_rclcpp_test

RCLCPP_COMPONENTS_REGISTER_NODE(play_launch_rclcpp_test::Unresolved)
