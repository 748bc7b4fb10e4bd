// Names, namespaces, remapping and where parameter values come from.
#include <filesystem>
#include <fstream>
#include <std_msgs/msg/string.hpp>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;

namespace {

void own_and_given_names(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  const Node plain("plain", options);
  CHECK(plain.name() == "plain" && plain.name_space() == "/" && plain.full_name() == "/plain");
  CHECK(plain.logger().name() == "plain");

  options.name = "given";
  options.name_space = "/a/b";
  const Node given("plain", options);
  CHECK(given.full_name() == "/a/b/given");
  CHECK(given.logger().name() == "a.b.given");
  CHECK(given.resolve_topic_name("chatter") == "/a/b/chatter");
  CHECK(given.resolve_topic_name("~/chatter") == "/a/b/given/chatter");

  options.name_space = "relative";
  CHECK(Node("plain", options).full_name() == "/relative/given");

  options.name = "not a name";
  CHECK_THROWS(Node("plain", options), RclError);
  CHECK_THROWS(Node("0bad", options_in(context)), RclError);
  CHECK_THROWS(Node("no_context", NodeOptions()), std::invalid_argument);
}

void arguments_of_the_node(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  options.arguments = {"-r", "__node:=renamed", "-r", "__ns:=/x",
                       "-r", "chatter:=/talk",  "-r", "serve:=provide"};
  Node node("plain", options);
  CHECK(node.full_name() == "/x/renamed");
  CHECK(node.resolve_topic_name("chatter") == "/talk");
  CHECK(node.resolve_service_name("serve") == "/x/provide");
  CHECK(node.create_publisher<std_msgs::msg::String>("chatter")->topic() == "/talk");

  options.name = "stronger";  // wins over the arguments
  CHECK(Node("plain", options).full_name() == "/x/stronger");

  options.arguments = {"--ros-args", "-r", "chatter:=/talk"};  // a second flag does no harm
  CHECK(Node("plain", options).resolve_topic_name("chatter") == "/talk");

  options.arguments = {"--no-such-flag"};
  const auto text = CHECK_THROWS(Node("plain", options), std::invalid_argument);
  CHECK(text.find("--no-such-flag") != std::string::npos);
  options.arguments = {"-r", "nonsense"};
  CHECK_THROWS(Node("plain", options), std::exception);
}

void global_arguments() {
  const auto context = make_context({"--ros-args", "-r", "__node:=container", "-r", "__ns:=/g",
                                     "-r", "chatter:=/global", "-p", "rate:=1.0"});
  NodeOptions options = options_in(context);
  CHECK(Node("plain", options).full_name() == "/g/container");
  options.name = "mine";
  CHECK(Node("plain", options).full_name() == "/g/mine");
  options.arguments = {"-r", "chatter:=/local"};
  CHECK(Node("plain", options).resolve_topic_name("chatter") == "/local");
  options.use_global_arguments = false;
  options.name.clear();
  options.arguments.clear();
  Node independent("plain", options);
  CHECK(independent.full_name() == "/plain");
  CHECK(independent.resolve_topic_name("chatter") == "/chatter");
  CHECK(independent.declare_parameter("rate", 7.0) == 7.0);
}

/// A parameter file that is gone with the object.
class ParameterFile {
 public:
  explicit ParameterFile(const std::string& text)
      : path_(std::filesystem::temp_directory_path() /
              ("sdk_names_test_" + std::to_string(getpid()) + ".yaml")) {
    std::ofstream(path_) << text;
  }
  ~ParameterFile() { std::filesystem::remove(path_); }
  ParameterFile(const ParameterFile&) = delete;
  ParameterFile& operator=(const ParameterFile&) = delete;
  [[nodiscard]] std::string path() const { return path_.string(); }

 private:
  std::filesystem::path path_;
};

void precedence() {
  const ParameterFile file(
      "/**:\n  ros__parameters: {all: 1, one: 1, two: 1, three: 1, nested: {deep: 4}}\n"
      "/ns/worker:\n  ros__parameters: {one: 2}\n"
      "/ns/other:\n  ros__parameters: {all: 99}\n"
      "/*/worker:\n  ros__parameters: {starred: 5}\n"
      "/*:\n  ros__parameters: {all: 98}\n");
  const auto context = make_context(
      {"--ros-args", "--params-file", file.path(), "-p", "two:=2", "-p", "worker:sided:=6"});
  NodeOptions options = options_in(context);
  options.name_space = "/ns";
  options.arguments = {"-p", "two:=3", "-p", "three:=3"};
  options.parameter_overrides = {{"three", std::int64_t{4}}};
  Node node("worker", options);
  CHECK(node.declare_parameter("all", 0) == 1);    // the file, for all nodes
  CHECK(node.declare_parameter("one", 0) == 2);    // the file, for this node
  CHECK(node.declare_parameter("two", 0) == 3);    // the node's arguments over the global ones
  CHECK(node.declare_parameter("three", 0) == 4);  // the overrides over all
  CHECK(node.declare_parameter("nested.deep", 0) == 4);
  CHECK(node.declare_parameter("starred", 0) == 5);
  CHECK(node.declare_parameter("nowhere", 9) == 9);
}

void extra_arguments_arrive_unchanged(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  options.extra_arguments = {{"use_intra_process_comms", true}, {"any.thing", std::vector{1.5}}};
  CHECK(Node("extra", options).options().extra_arguments == options.extra_arguments);
}

}  // namespace

int main() {
  const auto context = make_context();
  own_and_given_names(context);
  arguments_of_the_node(context);
  extra_arguments_arrive_unchanged(context);
  global_arguments();
  precedence();
  return 0;
}
