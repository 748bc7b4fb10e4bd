// How urgent a process is by what it asks of the kernel, and how its threads put that aside.

#include "base/scheduling.hpp"

#include <sched.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <thread>

#include "base/resource_setting.hpp"
#include "check.hpp"

using namespace play_launch;

namespace {

Urgency after(std::initializer_list<std::string> texts) {
  return urgency_after({SCHED_OTHER, 0, 0}, parse_resource_settings(texts));
}

void test_ranks() {
  const Urgency rising[] = {after({"scheduler 5 0"}),
                            after({"nice 5"}),
                            after({"scheduler 3 0"}),
                            after({"nice -1"}),
                            after({"scheduler 2 1", "nice 19"}),
                            after({"scheduler 1 99"})};
  for (std::size_t i = 1; i < std::size(rising); ++i) {
    CHECK(is_more_urgent(rising[i], rising[i - 1]) && !is_more_urgent(rising[i - 1], rising[i]));
  }
  for (const Urgency urgency : rising) {
    const bool highest = urgency.priority == 99;
    CHECK(is_more_urgent(just_above(urgency), urgency) != highest);
  }
  CHECK(!is_more_urgent(just_above(after({"nice -20"})), after({"nice -20"})));
}

/// A thread that has put its rank aside is not a real-time one, even if it is raised meanwhile,
/// and has what was asked for last when it takes it up again.
void test_a_rank_that_is_raised_while_it_is_aside() {
  const Urgency before = own_urgency();
  if (!assume(0, {SCHED_FIFO, 1, before.nice})) {
    std::puts("real-time scheduling takes CAP_SYS_NICE: not tested");
    return;
  }
  assume(0, before);
  Rank rank;
  std::atomic<bool> over{false};
  std::atomic<bool> was_raised{false};
  std::atomic<int> rounds{0};
  std::thread raised([&] {
    rank.begin();
    while (!over) {
      {
        const NotRealTime calm;
        for (int i = 0; i < 20; ++i) {
          CHECK(own_urgency().policy == SCHED_OTHER);
        }
      }
      CHECK(!was_raised || own_urgency().policy == SCHED_FIFO);
      ++rounds;
      std::this_thread::sleep_for(std::chrono::microseconds(50));
    }
    rank.end();
  });
  for (int turn = 0; turn < 20000 || rounds < 100; ++turn) {
    rank.rise({SCHED_FIFO, static_cast<std::int16_t>(1 + turn % 50), 0});
    was_raised = true;
  }
  over = true;
  raised.join();
  // A thread that has ended, or has not begun, is not touched.
  rank.rise({SCHED_FIFO, 9, 0});
}

/// What was asked for while the rank was aside holds afterwards.
void test_what_was_raised_meanwhile_holds() {
  const Urgency before = own_urgency();
  if (!assume(0, {SCHED_FIFO, 3, before.nice})) {
    return;
  }
  Rank rank;
  rank.begin();
  {
    const NotRealTime calm;
    rank.rise({SCHED_FIFO, 7, before.nice});
    CHECK(own_urgency().policy == SCHED_OTHER);
  }
  CHECK(own_urgency().priority == 7);
  {
    const NotRealTime calm;
    CHECK(own_urgency().policy == SCHED_OTHER);
  }
  CHECK(own_urgency().priority == 7);
  rank.end();
  assume(0, before);
  {
    const NotRealTime calm;
  }
  CHECK(own_urgency() == before);
}

}  // namespace

int main() {
  test_ranks();
  test_what_was_raised_meanwhile_holds();
  test_a_rank_that_is_raised_while_it_is_aside();
}
