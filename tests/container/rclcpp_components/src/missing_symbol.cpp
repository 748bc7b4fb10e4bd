#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>

namespace test_components {

int defined_nowhere();

class Unresolved : public rclcpp::Node {
 public:
  explicit Unresolved(const rclcpp::NodeOptions& options) : Node("unresolved", options) {
    declare_parameter("number", defined_nowhere());
  }
};

}  // namespace test_components

RCLCPP_COMPONENTS_REGISTER_NODE(test_components::Unresolved)
