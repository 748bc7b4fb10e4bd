// How a node that does not leave is made to, and when.

#include "hosts/isolated/leave_pressure.hpp"

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::container;
using namespace std::chrono_literals;

namespace {

using Action = LeavePressure::Action;
using Time = LeavePressure::Time;

constexpr Time kBegin{1h};
constexpr Time kNoEnd = Time::max();

void test_nobody_asked() {
  LeavePressure pressure;
  CHECK(!pressure.begun() && pressure.due(kNoEnd) == Time::max());
  CHECK(pressure.next(kBegin, kNoEnd) == Action::none);
}

void test_one_step_after_the_other() {
  LeavePressure pressure;
  pressure.begin(kBegin);
  pressure.begin(kBegin + 1h);  // asked again: no more time for that
  CHECK(pressure.due(kNoEnd) == kBegin);
  CHECK(pressure.next(kBegin, kNoEnd) == Action::ask);
  CHECK(pressure.next(kBegin, kNoEnd) == Action::none);
  const Time terminate = kBegin + LeavePressure::kPatience;
  CHECK(pressure.due(kNoEnd) == terminate);
  CHECK(pressure.next(terminate - 1ns, kNoEnd) == Action::none);
  CHECK(pressure.next(terminate, kNoEnd) == Action::terminate);
  const Time kill = terminate + LeavePressure::kLastPatience;
  CHECK(pressure.due(kNoEnd) == kill);
  CHECK(pressure.next(kill, kNoEnd) == Action::kill);
  CHECK(pressure.next(kill + 1h, kNoEnd) == Action::none);
  CHECK(pressure.due(kNoEnd) == Time::max());
}

void test_an_end_for_all() {
  LeavePressure pressure;
  pressure.begin(kBegin);
  const Time end = kBegin + 100ms;
  CHECK(pressure.next(kBegin, end) == Action::ask);
  CHECK(pressure.due(end) == kBegin + 50ms);
  CHECK(pressure.next(kBegin + 50ms, end) == Action::terminate);
  CHECK(pressure.due(end) == kBegin + 80ms);
  CHECK(pressure.next(kBegin + 80ms, end) == Action::kill);
}

void test_an_end_that_is_far_away_or_past() {
  LeavePressure patient;
  patient.begin(kBegin);
  CHECK(patient.next(kBegin, kBegin + 1h) == Action::ask);
  CHECK(patient.due(kBegin + 1h) == kBegin + LeavePressure::kPatience);
  LeavePressure late;
  late.begin(kBegin);
  for (const Action action : {Action::ask, Action::terminate, Action::kill}) {
    CHECK(late.next(kBegin, kBegin - 1s) == action);
  }
}

}  // namespace

int main() {
  test_nobody_asked();
  test_one_step_after_the_other();
  test_an_end_for_all();
  test_an_end_that_is_far_away_or_past();
}
