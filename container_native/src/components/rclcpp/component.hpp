#pragma once

#include <rclcpp/node_interfaces/node_base_interface.hpp>
#include <rclcpp_components/node_instance_wrapper.hpp>
#include <string>
#include <utility>

#include "components/component_backend.hpp"

namespace play_launch::rclcpp_backend {

/// What rclcpp_components makes, of any class that has a node.
class RclcppComponent final : public container::Component {
 public:
  using Node = rclcpp::node_interfaces::NodeBaseInterface;

  explicit RclcppComponent(rclcpp_components::NodeInstanceWrapper instance)
      : instance_(std::move(instance)), node_(instance_.get_node_base_interface()) {}

  std::string full_name() const override { return node_->get_fully_qualified_name(); }

  /// The node of a component that this backend made.
  static const Node::SharedPtr& node_of(const container::Component& component) {
    return static_cast<const RclcppComponent&>(component).node_;
  }

 private:
  rclcpp_components::NodeInstanceWrapper instance_;
  const Node::SharedPtr node_;
};

}  // namespace play_launch::rclcpp_backend
