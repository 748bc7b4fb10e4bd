#include "main/backends.hpp"

#include "components/native_backend.hpp"
#ifdef PLAY_LAUNCH_RCLCPP
#include "components/rclcpp/backend.hpp"
#include "components/rclcpp/runtime.hpp"
#endif

namespace play_launch::container {

std::vector<std::unique_ptr<ComponentBackend>> make_backends(int argc, const char* const* argv) {
  std::vector<std::unique_ptr<ComponentBackend>> backends;
#ifdef PLAY_LAUNCH_RCLCPP
  const std::shared_ptr<Context> context = rclcpp_backend::initialise(argc, argv);
  backends.push_back(std::make_unique<NativeBackend>(context));
  backends.push_back(std::make_unique<rclcpp_backend::RclcppBackend>(context));
#else
  backends.push_back(std::make_unique<NativeBackend>(Context::create(argc, argv)));
#endif
  return backends;
}

std::vector<std::string> backend_names() {
#ifdef PLAY_LAUNCH_RCLCPP
  return {"native", "rclcpp"};
#else
  return {"native"};
#endif
}

}  // namespace play_launch::container
