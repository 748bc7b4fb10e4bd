// Callback groups, cancelling, removing, and exceptions.
#include <algorithm>
#include <atomic>
#include <csignal>
#include <std_msgs/msg/string.hpp>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using namespace std::chrono_literals;
using String = std_msgs::msg::String;
using Kind = CallbackGroup::Kind;

namespace {

/// How many threads are inside at once, and the most there ever were.
struct Occupancy {
  Watched<int> inside;
  std::atomic<int> most{0};
  void enter() {
    inside.change([this](int& count) {
      ++count;
      most = std::max(most.load(), count);
    });
  }
  void leave() {
    inside.change([](int& count) { --count; });
  }
};

void reentrant_callbacks_run_in_parallel(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("reentrant", options_in(context));
  const auto group = node->create_callback_group(Kind::reentrant);
  MultiThreadedExecutor executor(3);
  executor.add_node(node);
  // The same subscription must be entered three times before it is left.
  Occupancy occupancy;
  Counter done;
  const auto publisher = node->create_publisher<String>("reentrant");
  const auto subscription = node->create_subscription<String>(
      "reentrant", 10,
      [&](const String&) {
        occupancy.enter();
        CHECK(occupancy.inside.reaches([&](int) { return occupancy.most.load() == 3; }));
        occupancy.leave();
        done.increment();
      },
      group);
  const Spinner spinner(executor);
  CHECK(eventually([&] { return publisher->subscription_count() == 1; }));
  for (int i = 0; i < 3; ++i) publisher->publish(String());
  CHECK(done.reaches_at_least(3));
}

void a_reentrant_timer_overlaps_itself(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("overlap", options_in(context));
  MultiThreadedExecutor executor(2);
  executor.add_node(node);
  Occupancy occupancy;
  Counter done;
  const auto timer = node->create_timer(
      1ms,
      [&] {
        occupancy.enter();
        CHECK(occupancy.inside.reaches([&](int) { return occupancy.most.load() >= 2; }));
        occupancy.leave();
        done.increment();
      },
      node->create_callback_group(Kind::reentrant));
  const Spinner spinner(executor);
  CHECK(done.reaches_at_least(2));
}

void exclusive_groups_take_turns(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("exclusive", options_in(context));
  const auto other_group = node->create_callback_group(Kind::mutually_exclusive);
  MultiThreadedExecutor executor(4);
  executor.add_node(node);
  Occupancy one;
  Occupancy both;
  Counter first;
  Counter second;
  Counter other;
  const auto body = [&](Counter& counter, bool in_one) {
    if (in_one) one.enter();
    both.enter();
    std::this_thread::yield();
    both.leave();
    if (in_one) one.leave();
    counter.increment();
  };
  const auto a = node->create_timer(0ns, [&] { body(first, true); });
  const auto b = node->create_timer(0ns, [&] { body(second, true); });
  const auto c = node->create_timer(0ns, [&] { body(other, false); }, other_group);
  const Spinner spinner(executor);
  CHECK(first.reaches_at_least(500) && second.reaches_at_least(500) && other.reaches_at_least(500));
  CHECK(one.most.load() == 1);
  CHECK(both.most.load() <= 2);
  // Fair: two always-ready timers of one group alternate.
  CHECK(std::abs(first.get() - second.get()) <= 2);
}

void a_blocked_group_blocks_no_other(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("blocked", options_in(context));
  const auto group = node->create_callback_group(Kind::mutually_exclusive);
  MultiThreadedExecutor executor(2);
  executor.add_node(node);
  Watched<bool> release{false};
  Watched<bool> blocked{false};
  Counter flood;
  Counter free_running;
  const auto publisher = node->create_publisher<String>("flood", 10);
  const auto blocker = node->create_timer(
      1ms,
      [&] {
        blocked.set(true);
        CHECK(release.reaches([](bool value) { return value; }));
      },
      group);
  const auto subscription = node->create_subscription<String>(
      "flood", 10, [&](const String&) { flood.increment(); }, group);
  const auto timer = node->create_timer(1ms, [&] { free_running.increment(); });
  const Spinner spinner(executor);
  CHECK(blocked.reaches([](bool value) { return value; }));
  for (int i = 0; i < 100; ++i) publisher->publish(String());
  CHECK(free_running.reaches_at_least(free_running.get() + 10));
  CHECK(flood.get() == 0);
  release.set(true);
  CHECK(flood.reaches_at_least(1));
}

void cancel_sticks(const std::shared_ptr<Context>& context) {
  SingleThreadedExecutor early;
  early.cancel();
  early.spin();  // returns
  MultiThreadedExecutor several(3);
  several.cancel();
  several.spin();

  // From a callback.
  auto node = std::make_shared<Node>("cancel", options_in(context));
  SingleThreadedExecutor own;
  own.add_node(node);
  const auto timer = node->create_timer(1ms, [&] { own.cancel(); });
  own.spin();

  // Only one may spin.
  auto witness_node = std::make_shared<Node>("witness", options_in(context));
  SingleThreadedExecutor busy;
  busy.add_node(witness_node);
  Counter ticks;
  const auto witness = witness_node->create_timer(1ms, [&] { ticks.increment(); });
  const Spinner spinner(busy);
  CHECK(ticks.reaches_at_least(1));
  CHECK_THROWS(busy.spin(), std::logic_error);
}

SingleThreadedExecutor* interrupted = nullptr;

void cancel_in_a_signal_handler(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("signal", options_in(context));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  interrupted = &executor;
  std::signal(SIGUSR1, [](int) { interrupted->cancel(); });
  const auto timer = node->create_timer(1ms, [] { raise(SIGUSR1); });
  executor.spin();
  std::signal(SIGUSR1, SIG_DFL);
}

void removing(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("remove", options_in(context));
  auto other = std::make_shared<Node>("other", options_in(context));
  MultiThreadedExecutor executor(2);
  SingleThreadedExecutor second_executor;
  executor.add_node(node);
  executor.add_node(other);
  CHECK_THROWS(executor.add_node(node), std::logic_error);
  CHECK_THROWS(second_executor.add_node(node), std::logic_error);
  second_executor.remove_node(node);  // not its node: nothing happens

  Watched<bool> inside{false};
  Watched<bool> release{false};
  std::atomic<bool> left{false};
  Counter calls;
  Watched<std::string> refused;
  const auto timer = node->create_timer(1ms, [&] {
    if (calls.get() == 0) {
      try {
        executor.remove_node(node);
      } catch (const std::logic_error& error) {
        refused.set(error.what());
      }
    }
    calls.increment();
    inside.set(true);
    CHECK(release.reaches([](bool value) { return value; }));
    left = true;
  });
  Watched<bool> removed{false};
  Counter others;
  const Spinner spinner(executor);
  CHECK(inside.reaches([](bool value) { return value; }));
  CHECK(!refused.get().empty());
  std::thread remover([&] {
    executor.remove_node(node);
    CHECK(left.load());
    removed.set(true);
  });
  const auto witness = other->create_timer(1ms, [&] { others.increment(); });
  CHECK(others.reaches_at_least(5));
  CHECK(!removed.get());
  release.set(true);
  remover.join();
  CHECK(removed.get());
  const int calls_then = calls.get();
  CHECK(others.reaches_at_least(others.get() + 10));
  CHECK(calls.get() == calls_then);
  CHECK(node.use_count() == 1);
  // It may go on elsewhere.
  second_executor.add_node(node);
  const Spinner second_spinner(second_executor);
  CHECK(calls.reaches_at_least(calls_then + 2));
}

void exceptions_leave_the_single_threaded_executor(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("thrower", options_in(context));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const auto timer =
      node->create_timer(1ms, []() { throw std::runtime_error("thrown on purpose"); });
  const auto text = CHECK_THROWS(executor.spin(), std::runtime_error);
  CHECK(text == "thrown on purpose");
  executor.remove_node(node);  // does not wait for the callback that threw
}

void an_idle_executor_sleeps(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("idle", options_in(context));
  MultiThreadedExecutor executor(4);
  executor.add_node(node);
  Counter ticks;
  const auto timer = node->create_timer(20ms, [&] { ticks.increment(); });
  const Spinner spinner(executor);
  CHECK(ticks.reaches_at_least(1));
  const std::clock_t before = std::clock();
  const auto started = std::chrono::steady_clock::now();
  CHECK(ticks.reaches_at_least(11));
  const double wall =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  const double cpu = static_cast<double>(std::clock() - before) / CLOCKS_PER_SEC;
  CHECK(cpu < 0.5 * wall);  // a busy loop would use all of at least one CPU
}

}  // namespace

int main() {
  const auto context = make_context();
  reentrant_callbacks_run_in_parallel(context);
  a_reentrant_timer_overlaps_itself(context);
  exclusive_groups_take_turns(context);
  a_blocked_group_blocks_no_other(context);
  cancel_sticks(context);
  cancel_in_a_signal_handler(context);
  removing(context);
  exceptions_leave_the_single_threaded_executor(context);
  an_idle_executor_sleeps(context);
  return 0;
}
