// Which node is asked for its parameters, and when.

#include "topic_recorder/asking_plan.hpp"

#include <chrono>
#include <string>
#include <vector>

#include "check.hpp"
#include "topic_recorder/selection.hpp"

using namespace play_launch::topics;
using namespace std::chrono_literals;

namespace {

const AskingPlan::Time kBegin{100s};
constexpr auto kPause = 10s;

AskableNode node(const std::string& name, std::vector<std::uint8_t> lives) {
  AskableNode made{name, {}};
  for (const std::uint8_t each : lives) {
    AskableNode::Life life{};
    life[0] = each;
    made.lives.insert(life);
  }
  return made;
}

/// All that it wants to ask now.
std::vector<std::string> asked(AskingPlan& plan, AskingPlan::Time now) {
  std::vector<std::string> names;
  while (const auto name = plan.next(now)) {
    names.push_back(*name);
  }
  return names;
}

using Names = std::vector<std::string>;

void test_each_node_once() {
  AskingPlan plan(kPause);
  CHECK(plan.due() == AskingPlan::Time::max() && asked(plan, kBegin).empty());
  plan.see({node("/a", {1})}, kBegin);
  CHECK(plan.due() == kBegin + AskingPlan::kRest);
  CHECK(asked(plan, kBegin + 500ms).empty());
  CHECK(asked(plan, kBegin + 1s) == Names{"/a"});
  CHECK(plan.due() == AskingPlan::Time::max());
  plan.answered("/a", kBegin + 2s);
  plan.see({node("/a", {1})}, kBegin + 3s);
  CHECK(plan.due() == AskingPlan::Time::max() && asked(plan, kBegin + 1h).empty());
}

void test_slowly() {
  AskingPlan plan(kPause);
  std::vector<AskableNode> nodes;
  for (char letter = 'a'; letter < 'k'; ++letter) {
    nodes.push_back(node(std::string("/") + letter, {static_cast<std::uint8_t>(letter)}));
  }
  plan.see(nodes, kBegin);
  auto now = kBegin + 10s;
  Names all;
  for (std::size_t i = 0; i < AskingPlan::kMostAtOnce; ++i) {
    const Names names = asked(plan, now);
    CHECK(names.size() == 1);
    all.push_back(names.front());
    now += AskingPlan::kBetween;
  }
  CHECK(asked(plan, now).empty() && plan.due() == AskingPlan::Time::max());
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    plan.answered(all[i], now);
    now += AskingPlan::kBetween;
    for (const std::string& name : asked(plan, now)) {
      all.push_back(name);
    }
  }
  CHECK(all.size() == nodes.size());
  CHECK(std::set<std::string>(all.begin(), all.end()).size() == nodes.size());
}

void test_again_in_each_life() {
  AskingPlan plan(kPause);
  plan.see({node("/a", {1})}, kBegin);
  CHECK(asked(plan, kBegin + 1s).size() == 1);
  plan.answered("/a", kBegin + 1s);
  // The dead one is still in the graph; then it leaves that.
  plan.see({node("/a", {1, 2})}, kBegin + 2s);
  plan.see({node("/a", {2})}, kBegin + 2s);
  CHECK(asked(plan, kBegin + 2s).empty());
  CHECK(asked(plan, kBegin + 3s).size() == 1);
  // Reloaded while it is asked: what it answers may be that of the life before.
  plan.see({node("/a", {3})}, kBegin + 3s);
  plan.answered("/a", kBegin + 4s);
  CHECK(plan.due() == kBegin + 5s && asked(plan, kBegin + 5s).size() == 1);
  plan.answered("/a", kBegin + 5s);
  CHECK(plan.due() == AskingPlan::Time::max());
  // Without a publisher of its own, that it was away is what can be known.
  plan.see({node("/a", {3}), node("/b", {})}, kBegin + 6s);
  CHECK(asked(plan, kBegin + 7s) == Names{"/b"});
  plan.answered("/b", kBegin + 7s);
  plan.see({node("/a", {3})}, kBegin + 8s);
  plan.see({node("/a", {3}), node("/b", {})}, kBegin + 9s);
  CHECK(asked(plan, kBegin + 10s) == Names{"/b"});
}

void test_those_that_do_not_answer() {
  AskingPlan plan(kPause);
  plan.see({node("/a", {1})}, kBegin);
  auto now = kBegin + 1s;
  for (int i = 1; i < AskingPlan::kMostFailures; ++i) {
    CHECK(asked(plan, now).size() == 1);
    CHECK(!plan.failed("/a", now));
    CHECK(plan.due() == now + kPause);
    now += kPause;
  }
  CHECK(asked(plan, now).size() == 1 && plan.failed("/a", now));
  CHECK(plan.due() == AskingPlan::Time::max());
  // Another life is another chance.
  plan.see({node("/a", {2})}, now);
  CHECK(asked(plan, now + 1s).size() == 1 && !plan.failed("/a", now + 1s));
}

void test_those_that_leave() {
  AskingPlan plan(kPause);
  plan.see({node("/a", {1}), node("/b", {2})}, kBegin);
  plan.see({node("/b", {2})}, kBegin);
  CHECK(asked(plan, kBegin + 1s) == Names{"/b"});
  plan.see({}, kBegin + 2s);
  CHECK(plan.failed("/b", kBegin + 6s));
  CHECK(plan.due() == AskingPlan::Time::max());
  plan.see({node("/b", {2})}, kBegin + 7s);
  CHECK(asked(plan, kBegin + 8s) == Names{"/b"});
}

void test_they_can_be_left_out() {
  Options options;
  CHECK(asks_for_parameters(options));
  options.excluded = {"/parameter_events"};
  CHECK(asks_for_parameters(options));
  options.excluded = {"/play_launch/parameters"};
  CHECK(!asks_for_parameters(options));
}

}  // namespace

int main() {
  test_each_node_once();
  test_slowly();
  test_again_in_each_life();
  test_those_that_do_not_answer();
  test_those_that_leave();
  test_they_can_be_left_out();
}
