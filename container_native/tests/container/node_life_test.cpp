// Every life that a node can have, looked at as often or as seldom as one likes: which calls come.

#include "hosts/isolated/node_life.hpp"

#include <algorithm>
#include <cstddef>
#include <vector>

#include "check.hpp"

using namespace play_launch::container;

namespace {

using Call = LifeCall;
using Calls = std::vector<LifeCall>;
/// What happens, in order.
using Life = std::vector<NodeLife>;

constexpr auto kEnd = NodeLife::ended | NodeLife::died;

bool contains_call(const Calls& calls, Call call) {
  return std::find(calls.begin(), calls.end(), call) != calls.end();
}

NodeLife whole(const Life& life) {
  NodeLife so_far = NodeLife::preparing;
  for (const NodeLife part : life) {
    so_far = so_far | part;
  }
  return so_far;
}

/// What of the program happens before the end of the process. A program comes so far unaided, in
/// a child or without one; it can be killed after each step.
std::vector<Life> programs() {
  using enum NodeLife;
  const std::vector<Life> whole_ones{
      {failed},                        // there is no such class
      {left},                          // cancelled before there was a process
      {constructing, failed},          // the constructor threw
      {constructing, left},            // cancelled meanwhile, in a process of another program
      {constructing, spinning, left},  // unloaded
  };
  std::vector<Life> all;
  for (const Life& life : whole_ones) {
    for (std::size_t length = 0; length <= life.size(); ++length) {
      all.emplace_back(life.begin(), life.begin() + static_cast<std::ptrdiff_t>(length));
    }
  }
  return all;
}

/// All lives: each program, killed or not, as the donor ends it.
std::vector<Life> lives() {
  std::vector<Life> all;
  for (const Life& program : programs()) {
    for (const bool clean : {false, true}) {
      Life life = program;
      life.push_back(ending(whole(program), clean));
      life.push_back(NodeLife::buried);
      all.push_back(life);
    }
  }
  return all;
}

/// The calls when a reader checks after those steps whose bit is set in `looks`, and at the end.
Calls calls_of(const Life& life, std::uint32_t looks) {
  LifeRecord record;
  LifeCalls due;
  Calls calls;
  for (std::size_t i = 0; i < life.size(); ++i) {
    record.add(life[i]);
    const bool last = i + 1 == life.size();
    if (last || (looks & (1U << i)) != 0) {
      while (const auto call = due.next(record.so_far())) {
        calls.push_back(*call);
      }
    }
  }
  CHECK(!due.next(record.so_far()));
  return calls;
}

void check_order(const Life& life, const Calls& calls) {
  const auto is_end = [](Call call) {
    return call == Call::load_failed || call == Call::load_crashed || call == Call::gone ||
           call == Call::crashed;
  };
  CHECK(std::count_if(calls.begin(), calls.end(), is_end) == 1);
  const auto end = std::find_if(calls.begin(), calls.end(), is_end);
  CHECK(calls.end() - end <= 2);
  CHECK(end + 1 == calls.end() || *(end + 1) == Call::buried);
  const bool died = has_any(whole(life), NodeLife::died);
  CHECK(contains_call(calls, Call::buried) == died);
  CHECK((*end == Call::crashed || *end == Call::load_crashed) == died);
  const auto loaded = std::find(calls.begin(), calls.end(), Call::loaded);
  const auto constructing = std::find(calls.begin(), calls.end(), Call::constructing);
  if (loaded != calls.end()) {
    CHECK(constructing < loaded && loaded < end);
    CHECK(*end == Call::crashed || *end == Call::gone);
  } else {
    CHECK(*end != Call::crashed);
  }
}

void test_every_life_however_often_one_looks() {
  for (const Life& life : lives()) {
    const Calls always = calls_of(life, ~0U);
    check_order(life, always);
    for (std::uint32_t looks = 0; looks < (1U << life.size()); ++looks) {
      CHECK(calls_of(life, looks) == always);
    }
  }
}

void test_calls() {
  using enum NodeLife;
  const auto calls = [](const Life& life) { return calls_of(life, 0); };
  CHECK((calls({constructing, spinning, left, ended, buried}) ==
         Calls{Call::constructing, Call::loaded, Call::gone}));
  CHECK((calls({constructing, failed, ended, buried}) ==
         Calls{Call::constructing, Call::load_failed}));
  CHECK((calls({failed, ended, buried}) == Calls{Call::load_failed}));
  CHECK((calls({left, ended, buried}) == Calls{Call::gone}));
  CHECK((calls({died, buried}) == Calls{Call::load_crashed, Call::buried}));
  CHECK((calls({constructing, died, buried}) ==
         Calls{Call::constructing, Call::load_crashed, Call::buried}));
  CHECK((calls({constructing, spinning, died, buried}) ==
         Calls{Call::constructing, Call::loaded, Call::crashed, Call::buried}));
  // In a destructor of a thread_local object, after all.
  CHECK((calls({constructing, spinning, left, died, buried}) ==
         Calls{Call::constructing, Call::loaded, Call::crashed, Call::buried}));
}

void test_what_an_end_counts_as() {
  using enum NodeLife;
  for (const Life& program : programs()) {
    const NodeLife so_far = whole(program);
    CHECK(ending(so_far, false) == died);
    CHECK((ending(so_far, true) == ended) == has_any(so_far, failed | left));
    CHECK(!has_any(so_far, kEnd));
  }
}

/// Whatever order the parts come in, even one that makes no sense: one end, and nothing twice.
void test_lives_that_make_no_sense() {
  Life parts{NodeLife::constructing, NodeLife::spinning, NodeLife::failed, NodeLife::left};
  std::sort(parts.begin(), parts.end());
  do {
    for (std::size_t length = 0; length <= parts.size(); ++length) {
      for (const NodeLife end : {NodeLife::ended, NodeLife::died}) {
        Life life(parts.begin(), parts.begin() + static_cast<std::ptrdiff_t>(length));
        life.insert(life.end(), {end, NodeLife::buried});
        for (std::uint32_t looks = 0; looks < (1U << life.size()); ++looks) {
          Calls calls = calls_of(life, looks);
          CHECK(std::count_if(calls.begin(), calls.end(), [](Call call) {
                  return call == Call::load_failed || call == Call::load_crashed ||
                         call == Call::gone || call == Call::crashed;
                }) == 1);
          std::sort(calls.begin(), calls.end());
          CHECK(std::adjacent_find(calls.begin(), calls.end()) == calls.end());
        }
      }
    }
  } while (std::next_permutation(parts.begin(), parts.end()));
}

}  // namespace

int main() {
  test_every_life_however_often_one_looks();
  test_calls();
  test_what_an_end_counts_as();
  test_lives_that_make_no_sense();
  return 0;
}
