// What the six parameter services answer, and what /parameter_events says.
#include <rcl_interfaces/msg/parameter_event.hpp>
#include <rcl_interfaces/srv/describe_parameters.hpp>
#include <rcl_interfaces/srv/get_parameter_types.hpp>
#include <rcl_interfaces/srv/get_parameters.hpp>
#include <rcl_interfaces/srv/list_parameters.hpp>
#include <rcl_interfaces/srv/set_parameters.hpp>
#include <rcl_interfaces/srv/set_parameters_atomically.hpp>

#include "client.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using namespace rcl_interfaces::srv;
using Event = rcl_interfaces::msg::ParameterEvent;
using Names = std::vector<std::string>;

namespace {

void listing(const std::shared_ptr<Context>& context) {
  Client<ListParameters> client(context, "/owner/list_parameters");
  const auto list = [&client](const Names& prefixes, std::uint64_t depth) {
    ListParameters::Request request;
    request.prefixes = prefixes;
    request.depth = depth;
    return client.call(request).result;
  };
  const Names all = {"camera.left.gain", "camera.rate", "cameras", "rate"};
  CHECK((list({}, 0).names == all));
  CHECK((list({}, 0).prefixes == Names{"camera.left", "camera"}));
  CHECK((list({}, 1).names == Names{"cameras", "rate"}));
  CHECK((list({}, 2).names == Names{"camera.rate", "cameras", "rate"}));
  CHECK((list({"camera"}, 0).names == Names{"camera.left.gain", "camera.rate"}));
  CHECK((list({"camera"}, 1).names == Names{"camera.rate"}));
  CHECK((list({"rate", "camera.left"}, 1).names == Names{"camera.left.gain", "rate"}));
  CHECK(list({"cam"}, 0).names.empty());
}

void getting(const std::shared_ptr<Context>& context) {
  GetParameters::Request request;
  request.names = {"rate", "undeclared", "camera.left.gain"};
  const auto values = Client<GetParameters>(context, "/owner/get_parameters").call(request).values;
  CHECK(values.size() == 3);
  CHECK(from_message(values[0]) == ParameterValue(10.0));
  CHECK(from_message(values[1]).index() == 0);
  CHECK(from_message(values[2]) == ParameterValue(std::int64_t{3}));

  GetParameterTypes::Request types_request;
  types_request.names = request.names;
  const auto types =
      Client<GetParameterTypes>(context, "/owner/get_parameter_types").call(types_request).types;
  CHECK((types == std::vector<std::uint8_t>{3, 0, 2}));

  DescribeParameters::Request describe_request;
  describe_request.names = request.names;
  const auto descriptors = Client<DescribeParameters>(context, "/owner/describe_parameters")
                               .call(describe_request)
                               .descriptors;
  CHECK(descriptors.size() == 3);
  CHECK(descriptors[0].name == "rate" && descriptors[0].type == 3);
  CHECK(descriptors[1].name == "undeclared" && descriptors[1].type == 0);
}

void setting(const std::shared_ptr<Context>& context, Node& owner) {
  SetParameters::Request request;
  request.parameters = {
      to_message(Parameter{"rate", 20.0}), to_message(Parameter{"undeclared", 1.0}),
      to_message(Parameter{"cameras", 1.0}), to_message(Parameter{"camera.rate", -1.0})};
  const auto results =
      Client<SetParameters>(context, "/owner/set_parameters").call(request).results;
  CHECK(results.size() == 4);
  CHECK(results[0].successful);
  CHECK(!results[1].successful && results[1].reason.find("not been declared") != std::string::npos);
  CHECK(!results[2].successful && results[2].reason.find("given double") != std::string::npos);
  CHECK(!results[3].successful && results[3].reason == "negative");
  CHECK(owner.get_parameter<double>("rate") == 20.0);

  Client<SetParametersAtomically> atomically(context, "/owner/set_parameters_atomically");
  SetParametersAtomically::Request all;
  all.parameters = {to_message(Parameter{"rate", 30.0}), to_message(Parameter{"undeclared", 1.0})};
  CHECK(!atomically.call(all).result.successful);
  CHECK(owner.get_parameter<double>("rate") == 20.0);
  all.parameters.pop_back();
  CHECK(atomically.call(all).result.successful);
  CHECK(owner.get_parameter<double>("rate") == 30.0);
}

}  // namespace

int main() {
  const auto context = make_context();
  const auto elsewhere = make_context();
  NodeOptions options = options_in(context);
  auto observer = std::make_shared<Node>("observer", options_in(elsewhere));
  Watched<std::vector<Event>> events;
  const auto subscription = observer->create_subscription<Event>(
      "/parameter_events", QoS::parameter_events(), [&](const Event& event) {
        if (event.node == "/owner") events.change([&](auto& all) { all.push_back(event); });
      });
  options.start_parameter_services = true;
  auto owner = std::make_shared<Node>("owner", options);
  CHECK(eventually([&] { return subscription->publisher_count() == 1; }));
  owner->declare_parameter("rate", 10.0);
  owner->declare_parameter("cameras", "none");
  owner->declare_parameter("camera.rate", 1.0);
  owner->declare_parameter("camera.left.gain", 3);
  owner->on_set_parameters([](const std::vector<Parameter>& parameters) {
    for (const auto& parameter : parameters) {
      if (parameter.value == ParameterValue(-1.0)) return SetParametersVerdict{false, "negative"};
    }
    return SetParametersVerdict{};
  });
  SingleThreadedExecutor executor;
  executor.add_node(owner);
  executor.add_node(observer);
  const Spinner spinner(executor);
  listing(elsewhere);
  getting(elsewhere);
  setting(elsewhere, *owner);
  // Discovery may have let the first ones go by; the last change is there for sure.
  CHECK(events.reaches([](const auto& all) {
    return !all.empty() && all.back().changed_parameters.size() == 1 &&
           from_message(all.back().changed_parameters[0]) == Parameter{"rate", 30.0};
  }));
  return 0;
}
