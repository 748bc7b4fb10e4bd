// Declaring, reading and setting parameters of all nine types; what is refused and with which text.
#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;

namespace {

const std::vector<Parameter> kNine = {
    {"b", true},
    {"i", std::int64_t{-7}},
    {"d", 2.5},
    {"s", std::string("text")},
    {"by", std::vector<std::uint8_t>{1, 255}},
    {"ba", std::vector<bool>{true, false}},
    {"ia", std::vector<std::int64_t>{1, -2}},
    {"da", std::vector<double>{0.5, 1.5}},
    {"sa", std::vector<std::string>{"x", "y"}},
};

void message_round_trip() {
  for (const auto& parameter : kNine) {
    const auto message = to_message(parameter);
    CHECK(message.value.type == parameter.value.index());
    CHECK(from_message(message) == parameter);
  }
  CHECK(from_message(to_message(Parameter{"unset", {}})).value.index() == 0);
  rcl_interfaces::msg::ParameterValue unknown;
  unknown.type = 200;
  CHECK(from_message(unknown).index() == 0);
  CHECK(std::string(parameter_type_name(200)) == "unknown");
}

void overrides_of_all_types(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  options.parameter_overrides = kNine;
  Node node("nine", options);
  CHECK(node.declare_parameter("b", false));
  CHECK(node.declare_parameter("i", 1) == -7);
  CHECK(node.declare_parameter("d", 0.0) == 2.5);
  CHECK(node.declare_parameter("s", "default") == "text");
  CHECK((node.declare_parameter("by", std::vector<std::uint8_t>{}) ==
         std::vector<std::uint8_t>{1, 255}));
  CHECK((node.declare_parameter("ba", std::vector<bool>{}) == std::vector<bool>{true, false}));
  CHECK((node.declare_parameter("ia", std::vector<std::int64_t>{}) ==
         std::vector<std::int64_t>{1, -2}));
  CHECK((node.declare_parameter("da", std::vector<double>{}) == std::vector<double>{0.5, 1.5}));
  CHECK((node.declare_parameter("sa", std::vector<std::string>{}) ==
         std::vector<std::string>{"x", "y"}));
  for (const auto& [name, value] : kNine) CHECK(node.get_parameter(name) == value);
}

void every_wrong_type_is_named(const std::shared_ptr<Context>& context) {
  for (const auto& declared : kNine) {
    for (const auto& given : kNine) {
      if (declared.value.index() == given.value.index()) continue;
      NodeOptions options = options_in(context);
      options.enable_rosout = false;
      options.parameter_overrides = {{"speed", given.value}};
      Node node("wrong", options);
      const auto text =
          CHECK_THROWS(node.declare_parameter("speed", declared.value), ParameterTypeError);
      CHECK(text.find("'speed'") != std::string::npos);
      CHECK(text.find(std::string("expected ") + parameter_type_name(declared.value)) !=
            std::string::npos);
      CHECK(text.find(std::string("given ") + parameter_type_name(given.value)) !=
            std::string::npos);
      CHECK(!node.has_parameter("speed"));
    }
  }
}

void unset_and_required(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  options.parameter_overrides = {{"unset", ParameterValue()}, {"given", std::string("here")}};
  Node node("required", options);
  const auto text = CHECK_THROWS(node.declare_parameter("unset", 1.0), ParameterTypeError);
  CHECK(text.find("given not set") != std::string::npos);
  CHECK(node.declare_required_parameter<std::string>("given") == "here");
  CHECK_THROWS(node.declare_required_parameter<std::string>("absent"), ParameterTypeError);
  // An open type takes what comes.
  CHECK(node.declare_parameter("open", ParameterValue()).index() == 0);
  CHECK(node.set_parameters({{"open", 1.0}}).ok);
  CHECK(node.set_parameters({{"open", std::string("now text")}}).ok);
  CHECK(node.get_parameter<std::string>("open") == "now text");
}

void narrow_integers(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  options.parameter_overrides = {{"small", std::int64_t{300}}, {"large", std::int64_t{1} << 40}};
  Node node("narrow", options);
  CHECK_THROWS(node.declare_parameter("small", std::uint8_t{1}), ParameterTypeError);
  CHECK(node.declare_parameter("large", std::int64_t{1}) == std::int64_t{1} << 40);
  CHECK_THROWS(node.get_parameter<int>("large"), ParameterTypeError);
}

void declaring_and_setting(const std::shared_ptr<Context>& context) {
  Node node("set", options_in(context));
  CHECK(!node.has_parameter("rate"));
  CHECK_THROWS(node.get_parameter("rate"), ParameterNotDeclared);
  CHECK(node.declare_parameter("rate", 10.0) == 10.0);
  CHECK_THROWS(node.declare_parameter("rate", 10.0), ParameterAlreadyDeclared);
  CHECK_THROWS(node.get_parameter<int>("rate"), ParameterTypeError);
  CHECK(node.declare_parameter("name", "bob") == "bob");

  auto verdict = node.set_parameters({{"rate", 5.0}, {"name", std::int64_t{1}}});
  CHECK(!verdict.ok);
  CHECK(verdict.reason.find("'name'") != std::string::npos);
  CHECK(verdict.reason.find("expected string, given integer") != std::string::npos);
  CHECK(node.get_parameter<double>("rate") == 10.0);  // all or none

  verdict = node.set_parameters({{"undeclared", 1.0}});
  CHECK(!verdict.ok && verdict.reason.find("not been declared") != std::string::npos);
  CHECK(!node.set_parameters({{"rate", ParameterValue()}}).ok);
  CHECK(node.set_parameters({{"rate", 5.0}, {"name", std::string("eve")}}).ok);
  CHECK(node.get_parameter<double>("rate") == 5.0);
  CHECK(node.get_parameter<std::string>("name") == "eve");
}

void the_node_may_refuse(const std::shared_ptr<Context>& context) {
  Node node("refuse", options_in(context));
  node.declare_parameter("rate", 10.0);
  node.on_set_parameters([&node](const std::vector<Parameter>& parameters) {
    for (const auto& parameter : parameters) {
      // Reading back here must not dead-lock.
      if (parameter.name == "rate" && node.get_parameter<double>("rate") != 10.0)
        return SetParametersVerdict{false, "changed"};
      if (parameter.value == ParameterValue(-1.0)) {
        return SetParametersVerdict{false, "must not be negative"};
      }
    }
    return SetParametersVerdict{};
  });
  const auto verdict = node.set_parameters({{"rate", -1.0}});
  CHECK(!verdict.ok && verdict.reason == "must not be negative");
  CHECK(node.get_parameter<double>("rate") == 10.0);
  CHECK_THROWS(node.declare_parameter("other", -1.0), ParameterRejected);
  CHECK(!node.has_parameter("other"));
  CHECK(node.set_parameters({{"rate", 3.0}}).ok);
}

}  // namespace

int main() {
  message_round_trip();
  const auto context = make_context();
  overrides_of_all_types(context);
  every_wrong_type_is_named(context);
  unset_and_required(context);
  narrow_integers(context);
  declaring_and_setting(context);
  the_node_may_refuse(context);
  return 0;
}
