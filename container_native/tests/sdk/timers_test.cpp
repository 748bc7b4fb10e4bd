// Timers: calling back, cancelling, resetting, letting go, and what a late one does.
#include <atomic>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using namespace std::chrono_literals;

namespace {

void ticks_cancels_and_restarts(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("ticks", options_in(context));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  Counter ticks;
  const auto timer = node->create_timer(2ms, [&] { ticks.increment(); });
  Counter other;
  const Spinner spinner(executor);
  CHECK(ticks.reaches_at_least(5));
  timer->cancel();
  CHECK(timer->cancelled());
  // One that was taken before may still come; a later timer shows when it is over.
  const auto witness = node->create_timer(10ms, [&] { other.increment(); });
  CHECK(other.reaches_at_least(1));
  const int stopped_at = ticks.get();
  CHECK(other.reaches_at_least(3));
  CHECK(ticks.get() == stopped_at);
  timer->reset();
  CHECK(ticks.reaches_at_least(stopped_at + 2));
  timer->reset(1h);
  CHECK(timer->period() == 1h);
}

void earlier_timers_overtake(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("overtake", options_in(context));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const auto far = node->create_timer(1h, [] {});
  Counter near;
  Counter pulled;
  const Spinner spinner(executor);
  const auto timer = node->create_timer(1ms, [&] { near.increment(); });
  CHECK(near.reaches_at_least(2));
  // Pulling a sleeping timer forward wakes the executor.
  const auto sleeper = node->create_timer(1h, [&] { pulled.increment(); });
  sleeper->reset(1ms);
  CHECK(pulled.reaches_at_least(1));
}

void made_in_a_callback(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("nested", options_in(context));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  Counter inner;
  std::shared_ptr<Timer> second;
  const auto first = node->create_timer(1ms, [&] {
    if (!second) second = node->create_timer(1ms, [&] { inner.increment(); });
  });
  const Spinner spinner(executor);
  CHECK(inner.reaches_at_least(3));
}

void letting_go_ends_it(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("gone", options_in(context));
  MultiThreadedExecutor executor(2);
  executor.add_node(node);
  std::atomic<int> gone{0};
  Counter alive;
  const Spinner spinner(executor);
  for (int i = 0; i < 200; ++i) {
    // Long ones are never due: the executor must forget them anyway.
    auto timer = node->create_timer(i % 2 == 0 ? 1h : 100us, [&] { ++gone; });
    timer.reset();
  }
  const auto timer = node->create_timer(1ms, [&] { alive.increment(); });
  CHECK(alive.reaches_at_least(3));
}

void missed_periods_are_skipped(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("late", options_in(context));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  std::vector<std::chrono::steady_clock::time_point> calls;
  Counter count;
  const auto timer = node->create_timer(20ms, [&] {
    calls.push_back(std::chrono::steady_clock::now());
    if (calls.size() == 1) {
      // Blocks for longer than two periods.
      const auto until = calls.back() + 50ms;
      while (std::chrono::steady_clock::now() < until) std::this_thread::sleep_until(until);
    }
    count.increment();
  });
  const Spinner spinner(executor);
  CHECK(count.reaches_at_least(3));
  // Not a burst: between the second and the third call lies something, as the phase is kept.
  CHECK(calls[1] - calls[0] >= 50ms);
  CHECK(calls[2] > calls[1]);
}

void bad_periods(const std::shared_ptr<Context>& context) {
  Node node("bad", options_in(context));
  CHECK_THROWS(node.create_timer(-1ns, [] {}), std::invalid_argument);
  const auto timer = node.create_timer(1s, [] {});
  CHECK_THROWS(timer->reset(-1ns), std::invalid_argument);
}

void zero_period_starves_no_other_timer(const std::shared_ptr<Context>& context) {
  auto node = std::make_shared<Node>("zero", options_in(context));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const auto greedy = node->create_timer(0ns, [] {});
  Counter other;
  const auto timer = node->create_timer(1ms, [&] { other.increment(); });
  const Spinner spinner(executor);
  CHECK(other.reaches_at_least(5));
}

}  // namespace

int main() {
  const auto context = make_context();
  ticks_cancels_and_restarts(context);
  earlier_timers_overtake(context);
  made_in_a_callback(context);
  letting_go_ends_it(context);
  missed_periods_are_skipped(context);
  bad_periods(context);
  zero_period_starves_no_other_timer(context);
  return 0;
}
