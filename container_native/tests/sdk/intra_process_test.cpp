// Delivery by pointer: which pointer arrives where, nothing twice, nothing lost to the outside.
#include <map>
#include <std_msgs/msg/string.hpp>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using String = std_msgs::msg::String;

namespace {

std::unique_ptr<String> text(const std::string& data) {
  auto message = std::make_unique<String>();
  message->data = data;
  return message;
}

NodeOptions by_pointer(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  options.use_intra_process_comms = true;
  return options;
}

using Seen = Watched<std::vector<std::pair<std::string, const String*>>>;

void note(Seen& seen, const String& message) {
  seen.change([&](auto& all) { all.emplace_back(message.data, &message); });
}

bool has(Seen& seen, std::size_t count) {
  return seen.reaches([count](const auto& all) { return all.size() >= count; });
}

void one_owner_gets_the_very_object(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("owner", by_pointer(context));
  const auto publisher = node->create_publisher<String>("owner");
  Seen seen;
  std::vector<std::unique_ptr<String>> kept;
  const auto subscription =
      node->create_subscription<String>("owner", 10, [&](std::unique_ptr<String> message) {
        kept.push_back(std::move(message));
        note(seen, *kept.back());
      });
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const Spinner spinner(executor);
  auto message = text("a");
  const String* const sent = message.get();
  publisher->publish(std::move(message));
  publisher->publish(*text("copied"));
  CHECK(has(seen, 2));
  CHECK(seen.get()[0].second == sent);
  CHECK(seen.get()[1].first == "copied");
  CHECK_THROWS(publisher->publish(std::unique_ptr<String>()), std::invalid_argument);
}

void sharers_see_the_same_object_and_owners_get_copies(const std::shared_ptr<Context>& context) {
  auto talker = std::make_shared<Node>("talker", by_pointer(context));
  auto listener = std::make_shared<Node>("listener", by_pointer(context));
  const auto publisher = talker->create_publisher<String>("shared");
  Seen reference;
  Seen shared;
  Seen owned;
  std::unique_ptr<String> kept;
  const auto first = listener->create_subscription<String>(
      "shared", 10, [&](const String& message) { note(reference, message); });
  const auto second = listener->create_subscription<String>(
      "shared", 10, [&](std::shared_ptr<const String> message) { note(shared, *message); });
  const auto third =
      talker->create_subscription<String>("shared", 10, [&](std::unique_ptr<String> message) {
        kept = std::move(message);
        note(owned, *kept);
      });
  MultiThreadedExecutor executor(2);
  executor.add_node(talker);
  executor.add_node(listener);
  const Spinner spinner(executor);
  auto message = text("b");
  const String* const sent = message.get();
  publisher->publish(std::move(message));
  CHECK(has(reference, 1) && has(shared, 1) && has(owned, 1));
  CHECK(reference.get()[0].second == sent);
  CHECK(shared.get()[0].second == sent);
  CHECK(owned.get()[0].second != sent && owned.get()[0].first == "b");
}

void mixed_with_the_middleware(const std::shared_ptr<Context>& context) {
  const auto elsewhere = make_context();
  auto inside = std::make_shared<Node>("inside", by_pointer(context));
  auto plain = std::make_shared<Node>("plain", options_in(context));
  auto outside = std::make_shared<Node>("outside", options_in(elsewhere));
  Seen by_pointer_seen;
  Seen plain_seen;
  Seen outside_seen;
  std::vector<std::shared_ptr<SubscriptionBase>> subscriptions;
  subscriptions.push_back(inside->create_subscription<String>(
      "mixed", 100, [&](const String& message) { note(by_pointer_seen, message); }));
  subscriptions.push_back(plain->create_subscription<String>(
      "mixed", 100, [&](const String& message) { note(plain_seen, message); }));
  subscriptions.push_back(outside->create_subscription<String>(
      "mixed", 100, [&](const String& message) { note(outside_seen, message); }));
  const auto publisher = inside->create_publisher<String>("mixed", 100);
  const auto plain_publisher = plain->create_publisher<String>("mixed", 100);
  const auto outside_publisher = outside->create_publisher<String>("mixed", 100);
  for (const auto& candidate : {publisher, plain_publisher, outside_publisher}) {
    CHECK(eventually([&] { return candidate->subscription_count() == 3; }));
  }
  for (const auto& subscription : subscriptions) {
    CHECK(eventually([&] { return subscription->publisher_count() == 3; }));
  }
  SingleThreadedExecutor executor;
  executor.add_node(inside);
  executor.add_node(plain);
  executor.add_node(outside);
  const Spinner spinner(executor);
  for (int i = 0; i < 20; ++i) {
    publisher->publish(text("pointer" + std::to_string(i)));
    plain_publisher->publish(text("plain" + std::to_string(i)));
    outside_publisher->publish(text("outside" + std::to_string(i)));
  }
  // The last of each publisher marks that all before have come, or will never.
  for (auto* seen : {&by_pointer_seen, &plain_seen, &outside_seen}) {
    CHECK(has(*seen, 60));
    std::map<std::string, int> count;
    for (const auto& [data, pointer] : seen->get()) ++count[data];
    CHECK(count.size() == 60);
    for (const auto& [data, times] : count) CHECK(times == 1);
  }
  // Duplicates would have come before these.
  publisher->publish(text("end"));
  for (auto* seen : {&by_pointer_seen, &plain_seen, &outside_seen}) {
    CHECK(has(*seen, 61));
    CHECK(seen->get().size() == 61);
  }
}

void a_full_inbox_drops_the_oldest(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("full", by_pointer(context));
  const auto publisher = node->create_publisher<String>("full");
  Seen seen;
  const auto subscription = node->create_subscription<String>(
      "full", 3, [&](std::shared_ptr<const String> message) { note(seen, *message); });
  for (int i = 0; i < 10; ++i) publisher->publish(text(std::to_string(i)));
  CHECK(subscription->dropped() == 7);
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const Spinner spinner(executor);
  CHECK(has(seen, 3));
  CHECK(seen.get()[0].first == "7" && seen.get()[2].first == "9");
}

void transient_local_goes_through_the_middleware(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("latched", by_pointer(context));
  const QoS latched = QoS(1).transient_local();
  const auto publisher = node->create_publisher<String>("latched", latched);
  publisher->publish(text("kept"));
  Seen seen;
  Seen volatile_seen;
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const Spinner spinner(executor);
  const auto subscription = node->create_subscription<String>(
      "latched", latched, [&](const String& message) { note(seen, message); });
  CHECK(has(seen, 1));
  const auto volatile_subscription = node->create_subscription<String>(
      "latched", 10, [&](const String& message) { note(volatile_seen, message); });
  CHECK(eventually([&] { return publisher->subscription_count() == 2; }));
  publisher->publish(text("new"));
  CHECK(has(seen, 2) && has(volatile_seen, 1));
  CHECK(volatile_seen.get()[0].first == "new");
}

void incompatible_endpoints_stay_apart(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("apart", by_pointer(context));
  const auto publisher = node->create_publisher<String>("apart", QoS(10).best_effort());
  Seen reliable;
  Seen best_effort;
  const auto first = node->create_subscription<String>(
      "apart", QoS(10), [&](const String& message) { note(reliable, message); });
  const auto second = node->create_subscription<String>(
      "apart", QoS(10).best_effort(), [&](const String& message) { note(best_effort, message); });
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const Spinner spinner(executor);
  publisher->publish(text("x"));
  CHECK(has(best_effort, 1));
  CHECK(reliable.get().empty());
}

}  // namespace

int main() {
  const auto context = make_context();
  one_owner_gets_the_very_object(context);
  sharers_see_the_same_object_and_owners_get_copies(context);
  mixed_with_the_middleware(context);
  a_full_inbox_drops_the_oldest(context);
  transient_local_goes_through_the_middleware(context);
  incompatible_endpoints_stay_apart(context);
  return 0;
}
