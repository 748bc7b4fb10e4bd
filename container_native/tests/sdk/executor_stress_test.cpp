// Nodes that are made, added, used, removed and destroyed in several threads at once while an
// executor spins: nothing of a node runs after remove_node, nothing hangs, nothing is lost.
#include <atomic>
#include <std_msgs/msg/string.hpp>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using namespace std::chrono_literals;
using String = std_msgs::msg::String;

namespace {

constexpr int kThreads = 4;

/// Talks to itself and to all others, makes and drops things in its callbacks, and ends the test
/// when a callback runs after it was said to be removed.
class Busy final : public Node {
 public:
  Busy(const std::string& name, const NodeOptions& options) : Node(name, options) {
    const auto reentrant = create_callback_group(CallbackGroup::Kind::reentrant);
    publisher_ = create_publisher<String>("busy", 5);
    by_pointer_ = create_subscription<String>(
        "busy", 5, [this](std::shared_ptr<const String>) { touch(); }, reentrant);
    owning_ = create_subscription<String>("busy", 5, [this](std::unique_ptr<String>) { touch(); });
    timer_ = create_timer(200us, [this] {
      touch();
      publisher_->publish(std::make_unique<String>());
      short_lived_ = create_timer(100us, [this] { touch(); });
      if (calls.get() % 8 == 0) {
        dropped_ = create_subscription<String>("busy", 1, [this](const String&) { touch(); });
      } else if (calls.get() % 8 == 4) {
        dropped_.reset();
      }
      PLAY_LAUNCH_DEBUG(logger(), "tick %d", calls.get());
    });
  }

  Counter calls;
  std::atomic<bool> removed{false};

 private:
  void touch() {
    CHECK(!removed.load());
    calls.increment();
  }

  std::shared_ptr<Publisher<String>> publisher_;
  std::shared_ptr<Subscription<String>> by_pointer_;
  std::shared_ptr<Subscription<String>> owning_;
  std::shared_ptr<Subscription<String>> dropped_;
  std::shared_ptr<Timer> timer_;
  std::shared_ptr<Timer> short_lived_;
};

void churn(Executor& executor, const std::shared_ptr<Context>& context, int rounds) {
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&, t] {
      for (int round = 0; round < rounds; ++round) {
        NodeOptions options = options_in(context);
        options.use_intra_process_comms = (t + round) % 2 == 0;
        options.start_parameter_services = round % 4 == 0;
        auto node = std::make_shared<Busy>("busy_" + std::to_string(t), options);
        executor.add_node(node);
        CHECK(node->calls.reaches_at_least(20));
        executor.remove_node(node);
        node->removed = true;
        CHECK(node.use_count() == 1);
      }
    });
  }
  for (auto& thread : threads) thread.join();
}

void run(Executor& executor, int rounds) {
  const auto context = make_context();
  // One node stays for the whole time.
  auto resident = std::make_shared<Busy>("resident", options_in(context));
  executor.add_node(resident);
  const Spinner spinner(executor);
  churn(executor, context, rounds);
  const int calls = resident->calls.get();
  CHECK(resident->calls.reaches_at_least(calls + 5));
}

void shutdown_amid_the_traffic(int rounds) {
  for (int round = 0; round < rounds; ++round) {
    const auto context = make_context();
    MultiThreadedExecutor executor(3);
    std::vector<std::shared_ptr<Busy>> nodes;
    for (int i = 0; i < 3; ++i) {
      NodeOptions options = options_in(context);
      options.use_intra_process_comms = true;
      nodes.push_back(std::make_shared<Busy>("busy_" + std::to_string(i), options));
      executor.add_node(nodes.back());
    }
    std::thread spinner([&] { executor.spin(); });
    CHECK(nodes.back()->calls.reaches_at_least(10));
    executor.cancel();
    spinner.join();
    for (const auto& node : nodes) {
      executor.remove_node(node);
      node->removed = true;
    }
    context->shutdown();
  }
}

}  // namespace

int main(int argc, char** argv) {
  const int rounds = argc > 1 ? std::atoi(argv[1]) : 6;
  {
    SingleThreadedExecutor executor;
    run(executor, rounds);
  }
  {
    MultiThreadedExecutor executor(3);
    run(executor, rounds);
  }
  shutdown_amid_the_traffic(rounds);
  return 0;
}
