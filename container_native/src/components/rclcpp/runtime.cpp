#include "components/rclcpp/runtime.hpp"

#include <rcl/error_handling.h>
#include <rcl/init.h>
#include <unistd.h>

#include <new>
#include <play_launch/detail/context_access.hpp>
#include <rclcpp/contexts/default_context.hpp>
#include <rclcpp/graph_listener.hpp>
#include <rclcpp/init_options.hpp>
#include <rclcpp/utilities.hpp>
#include <string>

#include "overrides/rclcpp_functions.hpp"

namespace play_launch::rclcpp_backend {
namespace {

/// rclcpp between its initialisation and its shutdown.
class Runtime {
 public:
  Runtime(int argc, const char* const* argv)
      : container_(::getpid()), context_(rclcpp::contexts::get_global_default_context()) {
    rclcpp::InitOptions options;
    options.shutdown_on_signal = false;
    rclcpp::init(argc, argv, options, rclcpp::SignalHandlerOptions::None);
    context_->add_pre_shutdown_callback([this] { on_shutdown_by_a_component(); });
    // The first node that looks at the graph would start this thread. It must not belong to the
    // process of a node: it serves all nodes, and would die with that one.
    graph_listener_ = context_->get_sub_context<rclcpp::graph_listener::GraphListener>(context_);
    graph_listener_->start_if_not_started();
    borrowed_ = detail::ContextAccess::borrow(context_->get_rcl_context().get());
    guard_default_context(borrowed_.get());
  }
  ~Runtime() {
    guard_default_context(nullptr);
    borrowed_.reset();
    graph_listener_->shutdown(std::nothrow);
    // Not rclcpp's shutdown(): it would call back into components that are destroyed by now.
    if (rcl_shutdown(context_->get_rcl_context().get()) != RCL_RET_OK) {
      rcl_reset_error();  // a component was faster
    }
  }
  Runtime(const Runtime&) = delete;
  Runtime& operator=(const Runtime&) = delete;

  Context* borrowed() const { return borrowed_.get(); }

 private:
  /// For Context::shutdown(), which cannot be kept from its work in another way: what is thrown
  /// here comes out of the component's call. rclcpp::shutdown() does not get here.
  void on_shutdown_by_a_component() const {
    if (!detail::ContextAccess::may_shut_down(*borrowed_, nullptr) && ::getpid() != container_) {
      throw ContextIsShared();
    }
  }

  const pid_t container_;
  const rclcpp::Context::SharedPtr context_;
  std::shared_ptr<rclcpp::graph_listener::GraphListener> graph_listener_;
  std::shared_ptr<Context> borrowed_;
};

}  // namespace

std::shared_ptr<Context> initialise(int argc, const char* const* argv) {
  const auto runtime = std::make_shared<Runtime>(argc, argv);
  return {runtime, runtime->borrowed()};
}

}  // namespace play_launch::rclcpp_backend
