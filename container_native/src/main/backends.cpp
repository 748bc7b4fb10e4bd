#include "main/backends.hpp"

#include "components/native_backend.hpp"
#ifdef PLAY_LAUNCH_RCLCPP
#include "components/rclcpp/backend.hpp"
#include "components/rclcpp/runtime.hpp"
#endif

namespace play_launch::container {

std::vector<std::unique_ptr<ComponentBackend>> make_backends(int argc, const char* const* argv) {
#ifdef PLAY_LAUNCH_RCLCPP
  return make_backends(rclcpp_backend::initialise(argc, argv));
#else
  return make_backends(Context::create(argc, argv));
#endif
}

std::vector<std::unique_ptr<ComponentBackend>> make_backends(
    const std::shared_ptr<Context>& context) {
  std::vector<std::unique_ptr<ComponentBackend>> backends;
  backends.push_back(std::make_unique<NativeBackend>(context));
#ifdef PLAY_LAUNCH_RCLCPP
  backends.push_back(std::make_unique<rclcpp_backend::RclcppBackend>(context));
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
