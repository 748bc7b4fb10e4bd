// Publishing and subscribing through the middleware, between contexts and inside one.
#include <atomic>
#include <std_msgs/msg/string.hpp>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using String = std_msgs::msg::String;

namespace {

String text(const std::string& data) {
  String message;
  message.data = data;
  return message;
}

void between_contexts() {
  const auto here = make_context();
  const auto there = make_context();
  auto talker = std::make_shared<Node>("talker", options_in(here));
  auto listener = std::make_shared<Node>("listener", options_in(there));
  Watched<std::vector<std::string>> by_reference;
  Watched<std::vector<std::string>> by_shared;
  Watched<std::vector<std::string>> by_unique;
  const auto first =
      listener->create_subscription<String>("pubsub", 10, [&](const String& message) {
        by_reference.change([&](auto& all) { all.push_back(message.data); });
      });
  const auto second = listener->create_subscription<String>(
      "pubsub", 10, [&](std::shared_ptr<const String> message) {
        by_shared.change([&](auto& all) { all.push_back(message->data); });
      });
  const auto third =
      listener->create_subscription<String>("pubsub", 10, [&](std::unique_ptr<String> message) {
        by_unique.change([&](auto& all) { all.push_back(message->data); });
      });
  const auto publisher = talker->create_publisher<String>("pubsub");
  CHECK(publisher->topic() == "/pubsub" && first->topic() == "/pubsub");
  SingleThreadedExecutor executor;
  executor.add_node(listener);
  const Spinner spinner(executor);
  CHECK(eventually([&] { return publisher->subscription_count() == 3; }));
  CHECK(eventually([&] { return first->publisher_count() == 1; }));
  for (int i = 0; i < 5; ++i) publisher->publish(text(std::to_string(i)));
  publisher->publish(std::make_unique<String>(text("5")));
  const std::vector<std::string> expected = {"0", "1", "2", "3", "4", "5"};
  for (auto* received : {&by_reference, &by_shared, &by_unique}) {
    CHECK(received->reaches([&](const auto& all) { return all.size() >= expected.size(); }));
    CHECK(received->get() == expected);
  }
}

void transient_local_reaches_late_joiners() {
  const auto context = make_context();
  auto node = std::make_shared<Node>("late", options_in(context));
  const QoS latched = QoS(1).transient_local();
  const auto publisher = node->create_publisher<String>("latched", latched);
  publisher->publish(text("kept"));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  Watched<std::string> received;
  const Spinner spinner(executor);
  const auto subscription = node->create_subscription<String>(
      "latched", latched, [&](const String& message) { received.set(message.data); });
  CHECK(received.reaches([](const auto& value) { return value == "kept"; }));
}

void messages_before_the_executor_are_not_lost() {
  const auto context = make_context();
  auto node = std::make_shared<Node>("early", options_in(context));
  const auto publisher = node->create_publisher<String>("early");
  Counter received;
  const auto subscription =
      node->create_subscription<String>("early", 10, [&](const String&) { received.increment(); });
  CHECK(eventually([&] { return publisher->subscription_count() == 1; }));
  for (int i = 0; i < 3; ++i) publisher->publish(text("x"));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const Spinner spinner(executor);
  CHECK(received.reaches_at_least(3));
}

void a_dropped_subscription_ends() {
  const auto context = make_context();
  auto node = std::make_shared<Node>("drop", options_in(context));
  const auto publisher = node->create_publisher<String>("drop");
  SingleThreadedExecutor executor;
  executor.add_node(node);
  Watched<bool> created{false};
  Counter received;
  std::shared_ptr<SubscriptionBase> subscription;
  const Spinner spinner(executor);
  // It releases itself in its own callback.
  const auto timer = node->create_timer(std::chrono::milliseconds(1), [&] {
    if (created.get()) return;
    subscription = node->create_subscription<String>("drop", 10, [&](const String&) {
      subscription.reset();
      received.increment();
    });
    created.set(true);
  });
  CHECK(created.reaches([](bool value) { return value; }));
  CHECK(eventually([&] { return publisher->subscription_count() == 1; }));
  publisher->publish(text("last"));
  CHECK(received.reaches_at_least(1));
  CHECK(eventually([&] { return publisher->subscription_count() == 0; }));
  publisher->publish(text("unheard"));
  CHECK(received.get() == 1);
}

void publishing_after_shutdown_is_harmless() {
  const auto context = make_context();
  Node node("over", options_in(context));
  const auto publisher = node.create_publisher<String>("over");
  context->shutdown();
  CHECK(!context->ok());
  publisher->publish(text("nothing"));
  CHECK(publisher->subscription_count() == 0);
}

}  // namespace

int main() {
  between_contexts();
  transient_local_reaches_late_joiners();
  messages_before_the_executor_are_not_lost();
  a_dropped_subscription_ends();
  publishing_after_shutdown_is_harmless();
  return 0;
}
