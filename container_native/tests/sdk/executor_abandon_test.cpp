// An executor whose threads are gone in the middle of a callback can be emptied and destroyed.
#include <unistd.h>

#include <std_msgs/msg/string.hpp>

#include <play_launch/detail/executor_access.hpp>
#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using String = std_msgs::msg::String;

namespace {

/// Stops the calling thread for good, as if its process had died there.
[[noreturn]] void vanish(Counter& vanished) {
  vanished.increment();
  while (true) pause();
}

template <class E, class... Arguments>
void abandon(const std::shared_ptr<Context>& context, int vanishing, Arguments... arguments) {
  // Never destroyed: the vanished threads refer to them.
  auto& vanished = *new Counter();
  auto* executor = new E(arguments...);
  NodeOptions options = options_in(context);
  options.use_intra_process_comms = true;
  auto node = std::make_shared<Node>("abandoned", options);
  const auto group = node->create_callback_group(CallbackGroup::Kind::reentrant);
  const auto publisher = node->create_publisher<String>("abandoned");
  auto reentrant = node->create_subscription<String>(
      "abandoned", 10, [&vanished](std::unique_ptr<String>) { vanish(vanished); }, group);
  auto exclusive = node->create_subscription<String>(
      "abandoned", 10, [&vanished](const String&) { vanish(vanished); });
  auto waiting = node->create_timer(std::chrono::milliseconds(1), [] {});
  executor->add_node(node);
  std::thread([executor] { executor->spin(); }).detach();
  for (int i = 0; i < 5; ++i) publisher->publish(String());
  CHECK(vanished.reaches_at_least(vanishing));

  executor->cancel();
  play_launch::detail::ExecutorAccess::abandon(*executor);
  executor->remove_node(node);
  CHECK(node.use_count() == 1);
  const std::weak_ptr<SubscriptionBase> first = reentrant;
  const std::weak_ptr<SubscriptionBase> second = exclusive;
  const std::weak_ptr<Timer> third = waiting;
  reentrant.reset();
  exclusive.reset();
  waiting.reset();
  node.reset();
  CHECK(first.expired() && second.expired() && third.expired());
  CHECK(publisher->subscription_count() == 0);
}

}  // namespace

int main() {
  const auto context = make_context();
  abandon<SingleThreadedExecutor>(context, 1);
  abandon<MultiThreadedExecutor>(context, 3, 3);
  std::fflush(nullptr);
  std::_Exit(0);
}
