// Decisions: which topics, asked for with which quality, how much of them.

#include "topic_recorder/selection.hpp"

#include <rmw/qos_profiles.h>

#include <iterator>
#include <stdexcept>
#include <vector>

#include "check.hpp"
#include "topic_recorder/byte_budget.hpp"
#include "topic_recorder/offered_qos.hpp"
#include "topic_recorder/type_support.hpp"

using namespace play_launch::topics;

namespace {

void test_patterns() {
  CHECK(matches("/a", "/a") && !matches("/a", "/a/b") && !matches("/a", "/b"));
  CHECK(matches("/a/*", "/a/b/c") && !matches("/a/*", "/a"));
  CHECK(matches("/cam?/image", "/cam1/image") && !matches("/cam?/image", "/cam10/image"));
  CHECK(matches("*", "/anything") && matches("*/image", "/a/b/image"));
  CHECK(!matches("*", "/_hidden") && !matches("/a/*", "/a/_action/feedback"));
  CHECK(matches("/a/_action/*", "/a/_action/feedback") && matches("/_hidden", "/_hidden"));
}

void test_treatment() {
  Options options;
  options.topics = {"/rosout", "/lidar/*"};
  options.excluded = {"*/compressed"};
  options.held = {"/camera/*", "/lidar/*", "/play_launch/*"};
  CHECK(treatment(options, "/rosout") == Treatment::recorded);
  CHECK(treatment(options, "/lidar/points") == Treatment::recorded);
  CHECK(treatment(options, "/camera/image") == Treatment::held);
  CHECK(treatment(options, "/camera/compressed") == Treatment::none);
  CHECK(treatment(options, "/tf") == Treatment::none);
  CHECK(treatment(options, "/play_launch/events") == Treatment::none);
}

void test_budgets() {
  const char* const argv[] = {"topic_recorder", "--socket",       "3",           "--topic-budget",
                              "/camera/*=500",  "--topic-budget", "/camera/a=7", "--topic-budget",
                              "*/points=0",     "--budget",       "90"};
  const Options options = parse_options(static_cast<int>(std::size(argv)), argv);
  CHECK(budget_of(options, "/camera/a") == 500);
  CHECK(budget_of(options, "/lidar/points") == 0);
  CHECK(budget_of(options, "/tf") == 90);
  CHECK(budget_of(Options(), "/tf") == 0);
  for (const char* wrong : {"/a", "/a=", "/a=x", "/a=-1"}) {
    const char* const bad[] = {"topic_recorder", "--socket", "3", "--topic-budget", wrong};
    CHECK_THROWS(parse_options(static_cast<int>(std::size(bad)), bad), std::invalid_argument);
  }
}

rmw_qos_profile_t profile(bool reliable, bool latched) {
  rmw_qos_profile_t made = rmw_qos_profile_default;
  made.reliability =
      reliable ? RMW_QOS_POLICY_RELIABILITY_RELIABLE : RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
  made.durability =
      latched ? RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL : RMW_QOS_POLICY_DURABILITY_VOLATILE;
  made.depth = 5;
  return made;
}

void test_requested_quality() {
  const auto both = request_for({profile(true, true), profile(true, true)});
  CHECK(both.reliability == RMW_QOS_POLICY_RELIABILITY_RELIABLE);
  CHECK(both.durability == RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL);
  const auto mixed = request_for({profile(true, false), profile(false, true)});
  CHECK(mixed.reliability == RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT);
  CHECK(mixed.durability == RMW_QOS_POLICY_DURABILITY_VOLATILE);
  CHECK(asks_too_much(both, mixed) && !asks_too_much(mixed, both) && !asks_too_much(both, both));
}

void test_offered_profiles() {
  const std::string text =
      offered_qos_profiles({profile(true, true), profile(false, false), profile(true, true)});
  CHECK(contains(text, "- history: 1\n  depth: 5\n  reliability: 1\n  durability: 1\n"));
  CHECK(contains(text, "\n- history: 1\n  depth: 5\n  reliability: 2\n  durability: 2\n"));
  // Equal ones are written once.
  CHECK(text.find("- history") != text.rfind("- history"));
  CHECK(text.size() < 1000);
}

void test_budget() {
  constexpr std::int64_t second = 1'000'000'000;
  ByteBudget unlimited(0);
  CHECK(unlimited.spend(1ULL << 40, second));
  ByteBudget budget(1000);
  CHECK(budget.spend(600, second) && !budget.spend(600, second));
  CHECK(budget.spend(400, second) && !budget.spend(1, second));
  CHECK(budget.spend(500, second + second / 2) && !budget.spend(500, second + second / 2));
  // What is larger than a second's bytes is recorded, and those after it pay.
  CHECK(budget.spend(3000, 10 * second) && !budget.spend(1, 11 * second));
  CHECK(!budget.spend(1, 12 * second) && budget.spend(900, 13 * second));
}

void test_types() {
  CHECK(message_type_support("rcl_interfaces/msg/Log") != nullptr);
  CHECK_THROWS(message_type_support("rcl_interfaces/msg/Nothing"), std::runtime_error);
  CHECK_THROWS(message_type_support("no_such_package/msg/Log"), std::runtime_error);
  CHECK_THROWS(message_type_support("../../x/msg/Log"), std::runtime_error);
  CHECK_THROWS(message_type_support("Log"), std::runtime_error);
}

}  // namespace

int main() {
  test_patterns();
  test_treatment();
  test_budgets();
  test_requested_quality();
  test_offered_profiles();
  test_budget();
  test_types();
}
