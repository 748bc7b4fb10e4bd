#include <signal.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <std_msgs/msg/string.hpp>
#include <std_srvs/srv/trigger.hpp>
#include <stdexcept>
#include <string>

namespace test_components {

/// Three functions deep, through frames with something to destroy.
[[gnu::noinline]] void throw_here(const std::string& text) {
  throw std::runtime_error(text + "on purpose");
}

[[gnu::noinline]] void throw_below(const std::string& text) {
  const std::string longer = text + "some functions below the callback, ";
  throw_here(longer);
  asm volatile("");  // not the last it does: a jump would leave no frame
}

/// With a handler that is not for this exception.
[[gnu::noinline]] void throw_far_below() {
  try {
    throw_below("thrown ");
  } catch (const std::logic_error&) {
    std::abort();
  }
}

/// Ends its process in the way it is told.
[[gnu::noinline]] void die(const std::string& how) {
  if (how == "segv") {
    *reinterpret_cast<volatile int*>(8) = 1;
  } else if (how == "abrt") {
    std::abort();
  } else if (how == "fpe") {
    ::raise(SIGFPE);
  } else if (how == "bus") {
    ::raise(SIGBUS);
  } else if (how == "ill") {
    ::raise(SIGILL);
  } else if (how == "kill") {
    ::kill(::getpid(), SIGKILL);
  } else if (how == "term") {
    ::kill(::getpid(), SIGTERM);
  } else if (how == "exception") {
    throw std::runtime_error("as asked for");
  } else if (how == "deep_exception") {
    throw_far_below();
  } else if (how == "exit") {
    std::exit(3);
  } else if (how == "shutdown") {
    rclcpp::shutdown();
  } else if (how == "shutdown_context") {
    rclcpp::contexts::get_global_default_context()->shutdown("as asked for");
  }
}

/// Dies `after` seconds (not at all if negative), or in its constructor, or of a message on `crash`
/// that tells how.
class Crasher : public rclcpp::Node {
 public:
  explicit Crasher(const rclcpp::NodeOptions& options) : Node("crasher", options) {
    const auto how = declare_parameter("how", std::string("segv"));
    subscription_ = create_subscription<std_msgs::msg::String>(
        "crash", 1, [](const std_msgs::msg::String& message) { die(message.data); });
    service_ = create_service<std_srvs::srv::Trigger>(
        "die", [how](const std::shared_ptr<std_srvs::srv::Trigger::Request>,
                     std::shared_ptr<std_srvs::srv::Trigger::Response>) { die(how); });
    if (declare_parameter("in_constructor", false)) {
      die(how);
    }
    const double after = declare_parameter("after", -1.0);
    if (after >= 0.0) {
      timer_ = create_wall_timer(std::chrono::duration<double>(after), [how] { die(how); });
    }
  }

 private:
  rclcpp::Subscription<std_msgs::msg::String>::SharedPtr subscription_;
  rclcpp::Service<std_srvs::srv::Trigger>::SharedPtr service_;
  rclcpp::TimerBase::SharedPtr timer_;
};

}  // namespace test_components

RCLCPP_COMPONENTS_REGISTER_NODE(test_components::Crasher)
