// What a constructor took that never came to its end can be given back.
#include <std_msgs/msg/string.hpp>
#include <std_srvs/srv/trigger.hpp>

#include <play_launch/detail/construction.hpp>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using std_msgs::msg::String;
using std_srvs::srv::Trigger;

namespace {

struct Parts {
  explicit Parts(Node& node)
      : publisher(node.create_publisher<String>("out")),
        subscription(node.create_subscription<String>("in", 10, [](const String&) {})),
        service(node.create_service<Trigger>("~/trigger",
                                             [](const Trigger::Request&, Trigger::Response&) {})) {}
  std::shared_ptr<Publisher<String>> publisher;
  std::shared_ptr<Subscription<String>> subscription;
  std::shared_ptr<Service<Trigger>> service;
};

NodeOptions by_pointer(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  options.use_intra_process_comms = true;
  options.start_parameter_services = true;
  return options;
}

void test_discarding(const std::shared_ptr<Context>& context) {
  Node neighbour("neighbour", by_pointer(context));
  const auto publisher = neighbour.create_publisher<String>("in");
  const auto subscription = neighbour.create_subscription<String>("out", 10, [](const String&) {});
  Construction construction;
  std::shared_ptr<Node> node;
  std::unique_ptr<Parts> parts;
  // In a thread that ends within the constructor, as far as anybody can see.
  std::thread([&] {
    auto* const watch = new Construction::Watch(construction);
    node = std::make_shared<Node>("half_built", by_pointer(context));
    parts = std::make_unique<Parts>(*node);
    static_cast<void>(watch);  // never destroyed
  }).join();
  CHECK(eventually([&] { return publisher->subscription_count() == 1; }));
  CHECK(eventually([&] { return subscription->publisher_count() == 1; }));
  construction.discard();
  CHECK(eventually([&] { return publisher->subscription_count() == 0; }));
  CHECK(eventually([&] { return subscription->publisher_count() == 0; }));
  // Here, other than after a death, the objects can still be destroyed.
  parts.reset();
  node.reset();
}

/// Who discards may do so in the very thread that was watched, and make nodes there.
void test_discarding_where_it_was_constructed(const std::shared_ptr<Context>& context) {
  Construction construction;
  static_cast<void>(new Construction::Watch(construction));  // never destroyed
  const auto half = std::make_unique<Node>("half_built", by_pointer(context));
  CHECK(Construction::is_watched());
  construction.discard();
  CHECK(!Construction::is_watched());
  const Node later("later", by_pointer(context));
  Node neighbour("neighbour", by_pointer(context));
  const auto publisher = neighbour.create_publisher<String>("in");
  const auto subscription = neighbour.create_subscription<String>("in", 10, [](const String&) {});
  CHECK(eventually([&] { return publisher->subscription_count() == 1; }));
  construction.discard();  // which has nothing of these
  CHECK(publisher->subscription_count() == 1);
}

void test_a_constructor_that_ends(const std::shared_ptr<Context>& context) {
  Construction construction;
  std::unique_ptr<Node> node;
  std::unique_ptr<Parts> kept;
  {
    const Construction::Watch watch(construction);
    node = std::make_unique<Node>("whole", by_pointer(context));
    const Parts given_up(*node);
    kept = std::make_unique<Parts>(*node);
  }
  construction.discard();  // there is nothing to discard any more
  CHECK(eventually([&] { return kept->publisher->subscription_count() == 0; }));
  CHECK(kept->subscription->publisher_count() == 0);
  kept.reset();
  node.reset();
}

}  // namespace

int main() {
  const auto context = make_context();
  test_a_constructor_that_ends(context);
  test_discarding(context);
  test_discarding_where_it_was_constructed(context);
}
