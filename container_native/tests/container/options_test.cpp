// What people write: the command line, load requests, the component index, failpoints.

#include "main/options.hpp"

#include <play_launch_msgs/msg/component_event.hpp>
#include <rcl_interfaces/msg/parameter_type.hpp>

#include "base/cpus.hpp"
#include "base/failpoints.hpp"
#include "check.hpp"
#include "components/component_index.hpp"
#include "components/component_options.hpp"

using namespace play_launch;
using namespace play_launch::container;
using rcl_interfaces::msg::ParameterType;

namespace {

Options parse(std::vector<const char*> arguments) {
  arguments.insert(arguments.begin(), "component_container");
  return parse_options(static_cast<int>(arguments.size()), arguments.data());
}

void test_command_line() {
  CHECK(parse({}).mode() == "standard" && parse({}).stop_timeout.count() == 2.0);
  const Options options = parse({"--thread_num", "5", "--ros-args", "-r", "__node:=a", "--isolated",
                                 "--", "--use_multi_threaded_executor", "--stop_timeout=0.5"});
  CHECK(options.mode() == "mt" && options.thread_num == 5 && options.stop_timeout.count() == 0.5);
  CHECK(!options.isolated && options.ros_arguments.size() == 3);
  CHECK(parse({"--isolated", "--use_multi_threaded_executor"}).mode() == "isolated_mt");
  using play_launch::isolation::MechanismChoice;
  CHECK(parse({"--isolated"}).isolation == MechanismChoice::automatic);
  CHECK(parse({"--isolated", "--isolation=process"}).isolation == MechanismChoice::process);
  CHECK(!parse({"--isolated"}).core_dumps && parse({"--isolated", "--core_dumps"}).core_dumps);
  CHECK(contains(CHECK_THROWS(parse({"--isolation", "cells"}), UsageError), "shared_memory"));
  CHECK(contains(CHECK_THROWS(parse({"--unknown"}), UsageError), "--unknown"));
  CHECK_THROWS(parse({"--thread_num", "-1"}), UsageError);
  CHECK_THROWS(parse({"--thread_num", "1x"}), UsageError);
  CHECK_THROWS(parse({"--thread_num"}), UsageError);
  CHECK_THROWS(parse({"--thread_num", "--ros-args"}), UsageError);
  CHECK_THROWS(parse({"--thread_num", "100000"}), UsageError);
  CHECK_THROWS(parse({"--stop_timeout", "nan"}), UsageError);
  CHECK_THROWS(parse({"--stop_timeout", "-1"}), UsageError);
  CHECK(executor_threads(3) == 3 && executor_threads(0) >= 2);
  CHECK(node_executor_threads(7) == 7 && node_executor_threads(0) <= 4);
}

rcl_interfaces::msg::Parameter bool_parameter(const std::string& name, bool value) {
  rcl_interfaces::msg::Parameter parameter;
  parameter.name = name;
  parameter.value.type = ParameterType::PARAMETER_BOOL;
  parameter.value.bool_value = value;
  return parameter;
}

void test_requests() {
  LoadRequest request;
  request.node_name = "name";
  request.node_namespace = "relative";
  request.remap_rules = {"a:=/b", "__node:=other"};
  request.extra_arguments = {bool_parameter("use_intra_process_comms", true),
                             bool_parameter("mine", true)};
  const ComponentOptions options = component_options(request);
  CHECK(options.node_namespace == "/relative" && options.use_intra_process_comms);
  CHECK(!options.forward_global_arguments && options.extra_arguments.size() == 1);
  CHECK((options.arguments == std::vector<std::string>{"-r", "a:=/b", "-r", "__node:=other"}));

  const auto fails = [](auto change) {
    LoadRequest bad;
    change(bad);
    return CHECK_THROWS(component_options(bad), LoadError);
  };
  CHECK(contains(fails([](LoadRequest& r) { r.node_name = "a/b"; }), "a/b"));
  CHECK(contains(fails([](LoadRequest& r) { r.node_namespace = "/a//b"; }), "/a//b"));
  CHECK(contains(fails([](LoadRequest& r) { r.remap_rules = {"ab"}; }), "'ab'"));
  CHECK(contains(fails([](LoadRequest& r) { r.remap_rules = {""}; }), "''"));
  CHECK(contains(fails([](LoadRequest& r) { r.log_level = 51; }), "51"));
  CHECK(contains(fails([](LoadRequest& r) {
                   rcl_interfaces::msg::Parameter p =
                       bool_parameter("forward_global_arguments", true);
                   p.value.type = ParameterType::PARAMETER_STRING;
                   r.extra_arguments = {p};
                 }),
                 "forward_global_arguments"));
  CHECK(contains(fails([](LoadRequest& r) {
                   rcl_interfaces::msg::Parameter p = bool_parameter("odd", true);
                   p.value.type = 10;
                   r.parameters = {p};
                 }),
                 "'odd'"));
  CHECK(contains(fails([](LoadRequest& r) { r.parameters = {bool_parameter("", true)}; }),
                 "without a name"));
}

void test_expected_names() {
  const auto expected = [](const std::string& name, const std::string& name_space,
                           const std::vector<std::string>& rules = {}) {
    LoadRequest request;
    request.node_name = name;
    request.node_namespace = name_space;
    request.remap_rules = rules;
    return expected_full_name(request).value_or("unknown");
  };
  CHECK(expected("a", "") == "/a" && expected("a", "/") == "/a");
  CHECK(expected("a", "/b/c") == "/b/c/a" && expected("a", "b") == "/b/a");
  CHECK(expected("", "/b") == "unknown");
  CHECK(expected("a", "", {"x:=y"}) == "/a");
  CHECK(expected("a", "", {"__ns:=/z"}) == "unknown");
}

void test_index_lines() {
  using Entries = std::vector<IndexEntry>;
  CHECK((parse_component_resource("a::B;lib/liba.so\r\n\n  \nc;/d.so") ==
         Entries{{"a::B", "lib/liba.so"}, {"c", "/d.so"}}));
  CHECK(parse_component_resource("").empty());
  for (const char* bad : {"a::B", ";lib", "a;", "a;b;c"}) {
    CHECK(contains(CHECK_THROWS(parse_component_resource(bad), LoadError), bad));
  }
}

void test_exceptions_are_described() {
  const auto describe = [](auto thrower) {
    try {
      thrower();
    } catch (...) {
      return describe_current_exception();
    }
    return std::string();
  };
  CHECK(describe([] { throw LoadError("plain"); }) == "plain");
  CHECK(describe([] { throw std::out_of_range("far"); }) == "std::out_of_range: far");
  CHECK(contains(describe([] { throw 42; }), "int"));
  const std::string nested = describe([] {
    try {
      throw std::invalid_argument("inner");
    } catch (...) {
      std::throw_with_nested(std::runtime_error("outer"));
    }
  });
  CHECK(contains(nested, "outer") && contains(nested, "std::invalid_argument: inner"));
}

void test_failpoints() {
  using play_launch_msgs::msg::ComponentEvent;
  arm_failpoints("");
  CHECK(!drops_event(ComponentEvent::LOADED) && !hit(Failpoint::drop_accepted));
  arm_failpoints(";container.drop_accepted=once;container.ignore_query=always;");
  CHECK(hit(Failpoint::drop_accepted) && !hit(Failpoint::drop_accepted));
  for (const auto& [name, type] :
       {std::pair("loading", ComponentEvent::LOADING), std::pair("loaded", ComponentEvent::LOADED),
        std::pair("failed", ComponentEvent::LOAD_FAILED),
        std::pair("unloaded", ComponentEvent::UNLOADED),
        std::pair("crashed", ComponentEvent::CRASHED)}) {
    arm_failpoints(std::string("container.drop_event=") + name);
    for (unsigned other = 0; other < 5; ++other) {
      CHECK(other == type || !drops_event(other));
    }
    CHECK(drops_event(type) && !drops_event(type));
  }
  CHECK(hit(Failpoint::ignore_query) && hit(Failpoint::ignore_query));
  arm_failpoints("container.after_accept=delay:1");
  CHECK(!hit(Failpoint::after_accept));
  for (const char* bad :
       {"container.nowhere=once", "container.before_hello", "container.before_hello=dance",
        "container.before_hello=delay", "container.before_hello=exit:x",
        "container.before_hello=hang:1", "container.drop_event=once"}) {
    CHECK(contains(CHECK_THROWS(arm_failpoints(bad), FailpointError), bad));
  }
}

}  // namespace

int main() {
  test_command_line();
  test_requests();
  test_expected_names();
  test_index_lines();
  test_exceptions_are_described();
  test_failpoints();
  return 0;
}
