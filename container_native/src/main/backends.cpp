#include "main/backends.hpp"

#include <utility>

#include "components/native_backend.hpp"
#ifdef PLAY_LAUNCH_RCLCPP
#include "components/rclcpp/backend.hpp"
#include "components/rclcpp/runtime.hpp"
#endif

namespace play_launch::container {

BackendList make_backends(int argc, const char* const* argv) {
#ifdef PLAY_LAUNCH_RCLCPP
  return make_backends(rclcpp_backend::initialise(argc, argv));
#else
  return make_backends(Context::create(argc, argv));
#endif
}

BackendList make_backends(const std::shared_ptr<Context>& context) {
  std::vector<std::unique_ptr<ComponentBackend>> backends;
  backends.push_back(std::make_unique<NativeBackend>(context));
#ifdef PLAY_LAUNCH_RCLCPP
  backends.push_back(std::make_unique<rclcpp_backend::RclcppBackend>(context));
#endif
  return BackendList(std::move(backends));
}

std::vector<std::string> backend_names() {
#ifdef PLAY_LAUNCH_RCLCPP
  return {"native", "rclcpp"};
#else
  return {"native"};
#endif
}

}  // namespace play_launch::container
