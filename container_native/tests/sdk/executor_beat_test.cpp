// An executor shows that it comes round: when it is idle, and as long as one thread of it is free.
#include <atomic>

#include <play_launch/detail/executor_access.hpp>
#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;

namespace {

using Beat = std::atomic<std::int64_t>;

/// Whether it moves on; waits for up to three of the seconds that it may stay as it is.
bool moves(const Beat& beat) {
  const std::int64_t before = beat;
  for (int i = 0; i < 3000 && beat == before; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return beat != before;
}

template <class E, class... Arguments>
void test_beat(const std::shared_ptr<Context>& context, bool moves_beside_a_callback,
               Arguments... arguments) {
  E executor(arguments...);
  Beat beat{0};
  play_launch::detail::ExecutorAccess::beat_into(executor, beat);
  CHECK(beat != 0);
  auto node = std::make_shared<Node>("beating", options_in(context));
  std::atomic<bool> asked{false};
  Counter entered;
  std::atomic<bool> enough{false};
  auto timer = node->create_timer(std::chrono::milliseconds(5), [&] {
    if (!asked || enough) return;
    entered.increment();
    while (!enough) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  });
  auto idle_node = std::make_shared<Node>("idle", options_in(context));
  executor.add_node(idle_node);
  std::thread spinning([&executor] { executor.spin(); });
  CHECK(moves(beat) && moves(beat));  // with nothing to do
  executor.add_node(node);
  asked = true;
  CHECK(entered.reaches_at_least(1));
  CHECK(moves(beat) == moves_beside_a_callback);
  enough = true;
  CHECK(moves(beat));
  executor.cancel();
  spinning.join();
  executor.remove_node(node);
}

}  // namespace

int main() {
  const auto context = make_context();
  test_beat<SingleThreadedExecutor>(context, false);
  test_beat<MultiThreadedExecutor>(context, true, 2);
  return 0;
}
