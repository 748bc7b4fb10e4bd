#pragma once

#include <memory>
#include <string>

#include "components/component_backend.hpp"

namespace play_launch::container {

/// Components written with this project's own SDK (play_launch/component.hpp).
class NativeBackend final : public ComponentBackend {
 public:
  explicit NativeBackend(std::shared_ptr<Context> context);

  std::shared_ptr<Context> context() override { return context_; }
  const ComponentIndex& index() const override { return index_; }
  std::unique_ptr<ComponentLibrary> open(const std::string& path) override;
  std::unique_ptr<ComponentExecutor> create_executor(
      const ExecutorChoice& choice, std::shared_ptr<detail::StopFlag> stop) override;
  /// Nodes of the SDK publish for themselves.
  bool with_logging_lock(const std::function<void()>& function) override {
    function();
    return true;
  }

 private:
  const std::shared_ptr<Context> context_;
  const ComponentIndex index_{"play_launch_components"};
};

}  // namespace play_launch::container
