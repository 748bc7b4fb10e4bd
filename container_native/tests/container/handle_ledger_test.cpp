// What a constructor took whose process died in it can be given back by another process.
#include <malloc.h>
#include <rcl/error_handling.h>
#include <rcl/logging_rosout.h>
#include <rcl/publisher.h>

#include <atomic>
#include <csignal>
#include <cstdlib>
#include <new>
#include <optional>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/detail/intra_process.hpp>
#include <std_msgs/msg/string.hpp>
#include <std_srvs/srv/trigger.hpp>
#include <vector>

#include "../isolation/harness.hpp"
#include "../sdk/check.hpp"
#include "overrides/handle_ledger.hpp"

/// operator new(std::nothrow) finds no memory.
std::atomic<bool> no_memory{false};

void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  return no_memory ? nullptr : std::malloc(size);
}
void operator delete(void* memory, const std::nothrow_t&) noexcept { std::free(memory); }

using namespace play_launch;
using namespace play_launch::testing;
using isolation_test::Event;
using isolation_test::Outcome;
using std_msgs::msg::String;
using std_srvs::srv::Trigger;

namespace {

/// Plays a node's program: runs a constructor, with a ledger.
class Construction final : public isolation::ChildProgram {
 public:
  explicit Construction(std::function<void()> constructor) : constructor_(std::move(constructor)) {}
  int run() override {
    const HandleLedger::Watch watch(ledger);
    constructor_();
    return 0;
  }
  void cancel() noexcept override {}
  HandleLedger* handles() noexcept override { return &ledger; }

  HandleLedger ledger;

 private:
  const std::function<void()> constructor_;
};

/// Plays the one that cleans up, on the same donor.
class Burial final : public isolation::ChildProgram {
 public:
  Burial(Construction& dead, Context& context) : dead_(dead), context_(context) {}
  int run() override {
    dead_.ledger.for_each_node([this](const rcl_node_t& node) {
      ++nodes;
      play_launch::detail::ContextAccess::intra_process(context_).remove_all_of(node);
    });
    dead_.ledger.give_back([this](const auto& function) {
      ++locked;
      function();
      return true;
    });
    return 0;
  }
  void cancel() noexcept override {}

  std::atomic<int> nodes{0};
  std::atomic<int> locked{0};

 private:
  Construction& dead_;
  Context& context_;
};

/// A constructor in a child and, when bury() is called, the child that cleans up.
class Half {
 public:
  Half(Context& context, std::function<void()> constructor)
      : construction_(std::move(constructor)), burial_(construction_, context), donor_("half", [&] {
          construction_end = isolation::run_in_child(construction_, slot_);
          dead_.set();
          buried_.wait();
          burial_end = isolation::run_in_child(burial_, slot_);
        }) {
    dead_.wait();
  }
  void bury() {
    buried_.set();
    donor_.join();
  }
  int nodes() const { return burial_.nodes; }
  int locked() const { return burial_.locked; }

  isolation::ChildEnd construction_end;
  isolation::ChildEnd burial_end;

 private:
  Construction construction_;
  Burial burial_;
  isolation::CrashSlot slot_;
  Event dead_;
  Event buried_;
  isolation::DonorThread donor_;
};

[[noreturn]] void die() {
  ::kill(::getpid(), SIGKILL);
  std::abort();
}

struct Parts {
  explicit Parts(Node& node)
      : publisher(node.create_publisher<String>("out")),
        subscription(node.create_subscription<String>("in", 10, [](const String&) {})),
        service(node.create_service<Trigger>("~/trigger",
                                             [](const Trigger::Request&, Trigger::Response&) {})) {}
  std::shared_ptr<Publisher<String>> publisher;
  std::shared_ptr<Subscription<String>> subscription;
  std::shared_ptr<Service<Trigger>> service;
};

NodeOptions by_pointer(const std::shared_ptr<Context>& context) {
  NodeOptions options = options_in(context);
  options.use_intra_process_comms = true;
  options.start_parameter_services = true;
  return options;
}

struct Neighbour {
  explicit Neighbour(const std::shared_ptr<Context>& context)
      : node("neighbour", by_pointer(context)),
        publisher(node.create_publisher<String>("in")),
        subscription(node.create_subscription<String>("out", 10, [](const String&) {})) {}

  /// Waits until it sees so many endpoints of others.
  bool sees(std::size_t count) const {
    return eventually([&] {
      return publisher->subscription_count() == count && subscription->publisher_count() == count;
    });
  }

  Node node;
  std::shared_ptr<Publisher<String>> publisher;
  std::shared_ptr<Subscription<String>> subscription;
};

void a_half_node_is_given_back(const std::shared_ptr<Context>& context) {
  const Neighbour neighbour(context);
  Half half(*context, [&] {
    auto* const node = new Node("half_built", by_pointer(context));
    new Parts(*node);
    {
      const Parts given_up(*node);
    }
    die();
  });
  CHECK(half.construction_end.signal == SIGKILL);
  CHECK(neighbour.sees(1));
  half.bury();
  CHECK(half.burial_end.clean());
  CHECK(half.nodes() == 1 && half.locked() == 0);
  CHECK(neighbour.sees(0));
}

void what_another_thread_opened_or_closed(const std::shared_ptr<Context>& context) {
  const Neighbour neighbour(context);
  Half half(*context, [&] {
    auto* const node = new Node("half_built", by_pointer(context));
    auto given_up = std::make_unique<Parts>(*node);
    std::thread([&] {
      given_up.reset();
      new Parts(*node);
    }).join();
    die();
  });
  CHECK(neighbour.sees(1));
  half.bury();
  CHECK(half.burial_end.clean());
  CHECK(neighbour.sees(0));
}

void a_constructor_that_ends_leaves_nothing_to_give_back(const std::shared_ptr<Context>& context) {
  const Neighbour neighbour(context);
  std::optional<Node> node;
  std::optional<Parts> parts;
  Half half(*context, [&] {
    node.emplace("whole", by_pointer(context));
    parts.emplace(*node);
  });
  CHECK(half.construction_end.clean());
  half.bury();
  CHECK(half.burial_end.clean());
  CHECK(half.nodes() == 0);
  CHECK(neighbour.sees(1));
}

/// rcl's own way to /rosout, which rclcpp takes: a table of all nodes, with pointers into them.
void a_node_in_the_table_for_rosout(const std::shared_ptr<Context>& context) {
  const Neighbour neighbour(context);
  rcl_node_t node = rcl_get_zero_initialized_node();
  Half half(*context, [&] {
    const rcl_node_options_t options = rcl_node_get_default_options();
    CHECK(rcl_node_init(&node, "logging", "", context->rcl(), &options) == RCL_RET_OK);
    CHECK(rcl_logging_rosout_init_publisher_for_node(&node) == RCL_RET_OK);
    die();
  });
  half.bury();
  CHECK(half.burial_end.clean());
  CHECK(half.nodes() == 1 && half.locked() == 1);
  CHECK(node.impl == nullptr);
  // A logging thread looks the name up in the table.
  PLAY_LAUNCH_INFO(Logger("logging"), "this name is unused");
}

/// Blocks of memory of 1 MiB and more.
std::size_t large_blocks() { return ::mallinfo2().hblks; }

void messages_by_pointer(const std::shared_ptr<Context>& context) {
  constexpr std::size_t kDepth = 5;
  CHECK(::mallopt(M_MMAP_THRESHOLD, 1 << 20) == 1);
  auto node = std::make_shared<Node>("talker", by_pointer(context));
  const auto publisher = node->create_publisher<String>("large");
  Half half(*context, [&] {
    auto* const half_built = new Node("half_built", by_pointer(context));
    static_cast<void>(new auto(
        half_built->create_subscription<String>("large", kDepth, [](std::unique_ptr<String>) {})));
    die();
  });
  CHECK(eventually([&] { return publisher->subscription_count() == 1; }));
  const std::size_t before = large_blocks();
  for (std::size_t i = 0; i < 4 * kDepth; ++i) {
    auto message = std::make_unique<String>();
    message->data.assign(2 << 20, 'x');
    publisher->publish(std::move(message));
  }
  CHECK(large_blocks() == before + kDepth);
  half.bury();
  CHECK(half.burial_end.clean());
  CHECK(large_blocks() == before);
  // The dead subscription does not count for one that is reached by pointer.
  const auto elsewhere = make_context();
  auto outside = std::make_shared<Node>("outside", options_in(elsewhere));
  Watched<std::string> heard;
  const auto subscription = outside->create_subscription<String>(
      "large", 10, [&](const String& message) { heard.set(message.data); });
  CHECK(eventually([&] { return publisher->subscription_count() == 1; }));
  CHECK(eventually([&] { return subscription->publisher_count() == 1; }));
  SingleThreadedExecutor executor;
  executor.add_node(outside);
  const Spinner spinner(executor);
  auto message = std::make_unique<String>();
  message->data = "to all";
  publisher->publish(std::move(message));
  CHECK(heard.reaches([](const std::string& text) { return text == "to all"; }));
}

void without_memory_only_the_latest_is_forgotten() {
  HandleLedger ledger;
  const HandleLedger::Watch watch(ledger);
  rcl_node_t first = rcl_get_zero_initialized_node();
  rcl_node_t second = rcl_get_zero_initialized_node();
  ledger.opened(HandleKind::node, &first, &first);
  no_memory = true;
  ledger.opened(HandleKind::node, &second, &second);
  no_memory = false;
  std::vector<rcl_node_t*> listed;
  ledger.for_each_node([&](rcl_node_t& node) { listed.push_back(&node); });
  CHECK(listed == std::vector{&first});
}

}  // namespace

int main() {
  without_memory_only_the_latest_is_forgotten();
  const auto context = make_context();
  a_half_node_is_given_back(context);
  what_another_thread_opened_or_closed(context);
  a_constructor_that_ends_leaves_nothing_to_give_back(context);
  a_node_in_the_table_for_rosout(context);
  messages_by_pointer(context);
}
