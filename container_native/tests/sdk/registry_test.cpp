// Components are found by class name and library.
#include <dlfcn.h>

#include <filesystem>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;

namespace demo {

class First final : public Node {
 public:
  explicit First(const NodeOptions& options) : Node("first", options) {
    declare_parameter("level", 1);
  }
};

class Broken final : public Node {
 public:
  explicit Broken(const NodeOptions& options) : Node("broken", options) {
    throw std::runtime_error("cannot be made");
  }
};

}  // namespace demo

PLAY_LAUNCH_REGISTER_COMPONENT(demo::First)
PLAY_LAUNCH_REGISTER_COMPONENT(demo::Broken)

int main() {
  auto& registry = ComponentRegistry::instance();
  const std::string here = std::filesystem::canonical("/proc/self/exe").string();
  CHECK((registry.names() == std::vector<std::string>{"demo::Broken", "demo::First"}));
  CHECK(registry.names(here).size() == 2);
  CHECK(registry.names("/no/such/library.so").empty());
  CHECK(registry.find("demo::Missing") == nullptr);
  CHECK(registry.find("demo::First", "/no/such/library.so") == nullptr);
  const auto* factory = registry.find("demo::First", here);
  CHECK(factory != nullptr && factory == registry.find("demo::First"));

  const auto context = make_context();
  NodeOptions options = options_in(context);
  options.name = "given";
  options.parameter_overrides = {{"level", std::int64_t{5}}};
  const auto node = factory->create(options);
  CHECK(node->full_name() == "/given" && node->get_parameter<int>("level") == 5);
  CHECK(CHECK_THROWS(registry.find("demo::Broken")->create(options), std::runtime_error) ==
        "cannot be made");
  options.parameter_overrides = {{"level", std::string("high")}};
  CHECK_THROWS(factory->create(options), ParameterTypeError);

  {
    const ComponentRegistration<demo::First> temporary("demo::Temporary");
    CHECK(registry.find("demo::Temporary") != nullptr);
  }
  CHECK(registry.find("demo::Temporary") == nullptr);
  return 0;
}
