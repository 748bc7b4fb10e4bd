#pragma once

#include <memory>
#include <string>

#include "components/component_backend.hpp"

namespace play_launch::rclcpp_backend {

/// Components written with rclcpp, registered with rclcpp_components.
class RclcppBackend final : public container::ComponentBackend {
 public:
  /// `context` is from initialise().
  explicit RclcppBackend(std::shared_ptr<Context> context);

  std::shared_ptr<Context> context() override { return context_; }
  const container::ComponentIndex& index() const override { return index_; }
  std::unique_ptr<container::ComponentLibrary> open(const std::string& path) override;
  std::unique_ptr<container::ComponentExecutor> create_executor(
      const container::ExecutorChoice& choice, std::shared_ptr<detail::StopFlag> stop) override;
  bool with_logging_lock(const std::function<void()>& function) override;

 private:
  const std::shared_ptr<Context> context_;
  const container::ComponentIndex index_{"rclcpp_components"};
};

}  // namespace play_launch::rclcpp_backend
