// Levels, what reaches /rosout, and logging while nodes come and go.
#include <atomic>
#include <rcl_interfaces/msg/log.hpp>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using Log = rcl_interfaces::msg::Log;

namespace {

void levels(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  CHECK(Node("plain", options).logger().level() == RCUTILS_LOG_SEVERITY_INFO);
  options.log_level = RCUTILS_LOG_SEVERITY_DEBUG;
  const Node chatty("chatty", options);
  CHECK(chatty.logger().enabled_for(RCUTILS_LOG_SEVERITY_DEBUG));
  options.log_level = 0;
  options.arguments = {"--log-level", "error"};
  CHECK(!Node("quiet", options).logger().enabled_for(RCUTILS_LOG_SEVERITY_WARN));
  options.arguments = {"--log-level", "warn", "--log-level", "named:=fatal"};
  CHECK(Node("named", options).logger().level() == RCUTILS_LOG_SEVERITY_FATAL);
  CHECK(Node("unnamed", options).logger().level() == RCUTILS_LOG_SEVERITY_WARN);

  // Arguments of disabled lines are not evaluated.
  int evaluated = 0;
  PLAY_LAUNCH_DEBUG(Node("plain", options_in(context)).logger(), "%d", ++evaluated);
  CHECK(evaluated == 0);
}

void rosout(const std::shared_ptr<Context>& context) {
  const auto elsewhere = make_context();
  auto listener = std::make_shared<Node>("listener", options_in(elsewhere));
  Watched<std::vector<Log>> lines;
  const auto subscription = listener->create_subscription<Log>(
      "/rosout", QoS::rosout(),
      [&](const Log& line) { lines.change([&](auto& all) { all.push_back(line); }); });
  SingleThreadedExecutor executor;
  executor.add_node(listener);
  const Spinner spinner(executor);

  NodeOptions options = options_in(context);
  options.name_space = "/a/b";
  auto node = std::make_unique<Node>("talker", options);
  const Logger kept = node->logger();
  PLAY_LAUNCH_INFO(node->logger(), "hello %d", 42);
  const std::string large(3000, 'x');
  PLAY_LAUNCH_WARN(node->logger(), "%s", large.c_str());
  CHECK(lines.reaches([](const auto& all) { return all.size() == 2; }));
  const auto all = lines.get();
  CHECK(all[0].name == "a.b.talker" && all[0].msg == "hello 42");
  CHECK(all[0].level == Log::INFO && all[0].function == "rosout" && all[0].line > 0);
  CHECK(all[0].file.find("logging_test.cpp") != std::string::npos);
  CHECK(all[0].stamp.sec > 0);
  CHECK(all[1].level == Log::WARN && all[1].msg == large);

  // A node that wants none, and a logger that outlived its node.
  options.enable_rosout = false;
  const Node silent("silent", options);
  PLAY_LAUNCH_INFO(silent.logger(), "to the console only");
  node.reset();
  PLAY_LAUNCH_INFO(kept, "after the end of the node");
  const Node last("last", options_in(context));
  PLAY_LAUNCH_INFO(last.logger(), "last");
  CHECK(lines.reaches([](const auto& seen) { return seen.back().msg == "last"; }));
  CHECK(lines.get().size() == 3);
}

void many_threads(const std::shared_ptr<Context>& context) {
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < 10; ++i) {
        const Node node("thread_" + std::to_string(t), options_in(context));
        PLAY_LAUNCH_INFO(node.logger(), "line %d", i);
      }
    });
  }
  for (auto& thread : threads) thread.join();
}

}  // namespace

int main() {
  const auto context = make_context();
  levels(context);
  rosout(context);
  many_threads(context);
  return 0;
}
