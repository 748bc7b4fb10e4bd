#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

#include "components/component_backend.hpp"

namespace play_launch::container {

/// Components written with this project's own SDK (play_launch/component.hpp).
class NativeBackend final : public ComponentBackend {
 public:
  explicit NativeBackend(std::shared_ptr<Context> context);

  std::string_view name() const override { return "native"; }
  std::shared_ptr<Context> context() override { return context_; }
  const ComponentIndex& index() const override { return index_; }
  std::optional<std::string> expected_full_name(const LoadRequest& request) const override;
  std::unique_ptr<Component> create(const LoadRequest& request,
                                    Construction* construction) override;
  std::unique_ptr<ComponentExecutor> create_executor(
      const ExecutorChoice& choice, std::shared_ptr<detail::StopFlag> stop) override;

 private:
  void open_library(const std::string& path);

  const std::shared_ptr<Context> context_;
  const ComponentIndex index_{"play_launch_components"};
  std::mutex mutex_;
  /// Never closed: code of a library may be needed until the process ends, for example by a
  /// message's deleter, a thread_local or a handler it registered.
  std::map<std::string, void*> libraries_;
};

}  // namespace play_launch::container
