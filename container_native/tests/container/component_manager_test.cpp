// The manager with a host that does what the test says: which events come, in which order.

#include "manager/component_manager.hpp"

#include <functional>
#include <map>
#include <system_error>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::container;

namespace {

class FakeHost final : public NodeHost {
 public:
  void set_observer(NodeHostObserver& given) override { observer = &given; }
  void load(std::uint64_t unique_id, LoadRequest) override {
    refuse();
    loads.push_back(unique_id);
  }
  void unload(std::uint64_t unique_id) override {
    refuse();
    unloads.push_back(unique_id);
  }
  void give_up(std::uint64_t unique_id) override { given_up.push_back(unique_id); }
  void stop_spinning() override {
    if (on_stop) {
      on_stop();
    }
  }

  void finish(std::uint64_t unique_id, const std::string& name) {
    if (!observer->on_loaded(unique_id, name)) {
      observer->on_gone(unique_id, "");
    }
  }
  void refuse() {
    if (no_threads) {
      throw std::system_error(EAGAIN, std::generic_category(), "thread");
    }
  }

  NodeHostObserver* observer = nullptr;
  std::vector<std::uint64_t> loads;
  std::vector<std::uint64_t> unloads;
  std::vector<std::uint64_t> given_up;
  std::function<void()> on_stop;
  bool no_threads = false;
};

class Recorder final : public EventSink {
 public:
  void on_event(const ComponentEvent& event) override { events.push_back(event); }

  std::vector<int> types() const {
    std::vector<int> types;
    for (const ComponentEvent& event : events) {
      types.push_back(event.event_type);
    }
    return types;
  }
  const ComponentEvent& last() const { return events.back(); }

  std::vector<ComponentEvent> events;
};

constexpr int kLoaded = ComponentEvent::LOADED;
constexpr int kUnloaded = ComponentEvent::UNLOADED;
constexpr int kFailed = ComponentEvent::LOAD_FAILED;
constexpr int kLoading = ComponentEvent::LOADING;
using Types = std::vector<int>;

struct Bench {
  Bench() { manager.add_sink(recorder); }

  std::uint64_t load(const std::string& name, std::uint64_t attempt = 0) {
    LoadRequest request;
    request.attempt = attempt;
    request.plugin_name = "ns::Plugin";
    request.node_name = name;
    std::uint64_t unique_id = 0;
    const std::size_t events = recorder.events.size();
    const auto refusal = manager.load(request, [&](std::uint64_t accepted) {
      unique_id = accepted;
      CHECK(recorder.events.size() == events);  // the acceptance comes before all events
    });
    CHECK(!refusal);
    return unique_id;
  }
  std::uint64_t loaded(const std::string& name) {
    const std::uint64_t unique_id = load(name);
    host.finish(unique_id, "/" + name);
    return unique_id;
  }

  FakeHost host;
  ObservableComponentManager manager{host, play_launch::ProcessIdentity{1, 2}};
  Recorder recorder;
};

void test_load_and_unload() {
  Bench bench;
  const std::uint64_t unique_id = bench.load("a", 5);
  bench.host.observer->on_constructing(unique_id, {7, 8}, CLOCK_THREAD_CPUTIME_ID);
  bench.host.finish(unique_id, "/a");
  CHECK((bench.recorder.types() == Types{kLoading, kLoaded}));
  CHECK(bench.recorder.last().attempt == 5 && bench.recorder.last().pid == 7);
  CHECK(bench.recorder.last().start_time == 8 && bench.recorder.last().stamp.sec > 0);
  CHECK(!bench.manager.unload(unique_id));
  CHECK(bench.host.unloads == std::vector{unique_id});
  CHECK(!bench.manager.unload(unique_id));  // is under way already
  CHECK(bench.host.unloads.size() == 1);
  bench.host.observer->on_gone(unique_id, "");
  CHECK((bench.recorder.types() == Types{kLoading, kLoaded, kUnloaded}));
  CHECK(bench.recorder.last().error_message.empty());
  CHECK(bench.manager.unload(unique_id).has_value());
  CHECK(bench.load("a", 5) == unique_id);  // repeated
  CHECK(bench.host.loads.size() == 1);
}

void test_failures() {
  Bench bench;
  const std::uint64_t failed = bench.load("a");
  bench.host.observer->on_load_failed(failed, "why");
  CHECK((bench.recorder.types() == Types{kLoading, kFailed}));
  CHECK(bench.recorder.last().error_message == "why");
  bench.loaded("b");
  bench.recorder.events.clear();
  bench.load("b");
  CHECK((bench.recorder.types() == Types{kLoading, kFailed}));
  CHECK(contains(bench.recorder.last().error_message, "/b"));
  CHECK(bench.manager.nodes().size() == 1);
  bench.host.no_threads = true;
  bench.load("c");
  CHECK(bench.recorder.last().event_type == kFailed);
  CHECK(contains(bench.recorder.last().error_message, "thread"));
}

void test_unloading_that_cannot_start() {
  Bench bench;
  const std::uint64_t unique_id = bench.loaded("a");
  bench.host.no_threads = true;
  CHECK(contains(bench.manager.unload(unique_id).value_or(""), "thread"));
  CHECK(bench.manager.nodes()[0].entry.state == NodeState::loaded);
  bench.host.no_threads = false;
  CHECK(!bench.manager.unload(unique_id));
}

void test_cancel() {
  Bench bench;
  const std::uint64_t before = bench.load("a");
  CHECK(!bench.manager.cancel(before));
  bench.host.finish(before, "/a");
  CHECK((bench.recorder.types() == Types{kLoading, kUnloaded}));
  CHECK(bench.recorder.last().error_message == "cancelled");

  const std::uint64_t failing = bench.load("a");
  CHECK(!bench.manager.cancel(failing));
  bench.host.observer->on_load_failed(failing, "boom");
  CHECK(bench.recorder.last().event_type == kUnloaded);
  CHECK(contains(bench.recorder.last().error_message, "boom"));

  // The host makes it leave, and need not be asked.
  const std::uint64_t late = bench.load("a");
  CHECK(!bench.manager.cancel(late));
  CHECK(!bench.host.observer->on_loaded(late, "/a"));
  CHECK(bench.manager.nodes().back().entry.state == NodeState::unloading);
  CHECK(!bench.manager.unload(late));  // is under way already
  CHECK(bench.host.unloads.empty());
  bench.host.observer->on_gone(late, "");
  CHECK(bench.recorder.last().event_type == kUnloaded);
  CHECK(bench.recorder.last().full_node_name == "/a");

  const std::uint64_t loaded = bench.loaded("a");
  CHECK(!bench.manager.cancel(loaded));
  bench.host.observer->on_gone(loaded, "");
  CHECK(bench.recorder.last().error_message == "cancelled");
}

void test_crash() {
  Bench bench;
  const std::uint64_t unique_id = bench.loaded("a");
  bench.host.observer->on_crashed(unique_id, {0, 11, "SIGSEGV", {"frame"}, {}, {}, false});
  const ComponentEvent& event = bench.recorder.last();
  CHECK(event.event_type == ComponentEvent::CRASHED && event.signal == 11);
  CHECK(event.backtrace == std::vector<std::string>{"frame"});
  CHECK(bench.manager.empty());
  CHECK(bench.manager.totals().crashes == 1 && bench.manager.totals().unquiesced == 0);
  NodeDeath death;
  death.unquiesced = true;
  for (const bool complete : {true, false}) {
    const std::uint64_t constructing = bench.load("b");
    bench.host.observer->on_load_crashed(constructing, death);
    bench.host.observer->on_buried(constructing, complete);
  }
  const DeathTotals totals = bench.manager.totals();
  CHECK(totals.crashes == 3 && totals.unquiesced == 2);
  CHECK(totals.undertaken == 1 && totals.leaked == 1);
}

void test_deaths_of_nodes_that_nobody_wants() {
  Bench bench;
  const std::uint64_t unloading = bench.loaded("a");
  CHECK(!bench.manager.unload(unloading));
  bench.host.observer->on_crashed(unloading, {0, 11, "in its destructor", {}, {}, {}, false});
  CHECK(bench.recorder.last().event_type == ComponentEvent::CRASHED);
  CHECK(bench.recorder.last().signal == 11);
  CHECK(contains(bench.recorder.last().error_message, "in its destructor"));

  const std::uint64_t terminated = bench.loaded("t");
  CHECK(!bench.manager.unload(terminated));
  bench.host.observer->on_crashed(terminated, {0, 15, "by a signal that ends", {}, {}, {}, false});
  CHECK(bench.recorder.last().event_type == kUnloaded && bench.recorder.last().signal == 15);

  const std::uint64_t exited = bench.loaded("e");
  CHECK(!bench.manager.unload(exited));
  bench.host.observer->on_crashed(exited, {3, 0, "exit code 3", {}, {}, {}, false});
  CHECK(bench.recorder.last().event_type == ComponentEvent::CRASHED);

  const std::uint64_t cancelled = bench.load("b");
  CHECK(!bench.manager.cancel(cancelled));
  CHECK(bench.host.given_up == std::vector{cancelled});
  bench.host.observer->on_load_crashed(cancelled, {0, 6, "in its constructor", {}, {}, {}, false});
  CHECK(bench.recorder.last().event_type == kUnloaded && bench.recorder.last().signal == 6);
  CHECK(contains(bench.recorder.last().error_message, "loading failed as well: in its"));

  const std::uint64_t hanging = bench.load("h");
  CHECK(!bench.manager.unload(hanging));
  CHECK(!bench.manager.unload(hanging));  // is under way already
  CHECK((bench.host.given_up == std::vector{cancelled, hanging}));
  bench.host.observer->on_load_crashed(hanging, {0, 9, "SIGKILL", {}, {}, {}, false});
  CHECK(bench.recorder.last().event_type == kUnloaded && bench.recorder.last().signal == 9);
  CHECK(bench.recorder.last().error_message == "cancelled; it did not leave in order: SIGKILL");
}

void test_names() {
  Bench bench;
  const std::uint64_t first = bench.loaded("c");
  bench.load("c");  // asked for: it never comes to the host
  CHECK(bench.host.loads == std::vector{first});
  CHECK(bench.recorder.last().event_type == kFailed);
  CHECK(contains(bench.recorder.last().error_message, "a node named /c is loaded"));

  const std::uint64_t namesake = bench.load("");
  CHECK(bench.host.observer->on_loaded(namesake, "/c"));
  CHECK(bench.recorder.last().event_type == ComponentEvent::LOADED);
  CHECK(bench.recorder.last().full_node_name == "/c");
  CHECK(!bench.manager.unload(first));  // that one, not its namesake
  CHECK(bench.host.unloads == std::vector{first});
}

void test_death_while_loading() {
  Bench bench;
  const auto long_ago = std::chrono::steady_clock::now() - std::chrono::hours(1);
  bench.host.observer->on_load_crashed(bench.load("a"),
                                       {0, 6, "why", {"frame"}, {"module"}, long_ago, false});
  CHECK((bench.recorder.types() == Types{kLoading, kFailed}));
  const ComponentEvent& event = bench.recorder.last();
  CHECK(event.signal == 6 && event.error_message == "why" && event.backtrace.size() == 1);
  CHECK(event.modules == std::vector<std::string>{"module"});
  CHECK(event.stamp.sec < bench.recorder.events.front().stamp.sec);
}

void test_stop() {
  Bench bench;
  const std::uint64_t loaded = bench.loaded("a");
  const std::uint64_t constructing = bench.load("b");
  int empty = 0;
  bench.manager.begin_stop([&empty] { ++empty; });
  LoadRequest request;
  CHECK(bench.manager.load(request, [](std::uint64_t) {}).has_value());
  CHECK(bench.host.unloads == std::vector{loaded});
  bench.host.observer->on_gone(loaded, "");
  CHECK(bench.recorder.last().error_message.empty() && empty == 0);
  bench.host.finish(constructing, "/b");
  CHECK(bench.recorder.last().error_message == "cancelled" && empty == 1);

  Bench idle;
  idle.manager.begin_stop([&empty] { ++empty; });
  CHECK(empty == 2);
}

void test_nodes_that_end_as_soon_as_they_spin_no_more() {
  Bench bench;
  const std::uint64_t killed = bench.loaded("a");
  const std::uint64_t faulty = bench.loaded("b");
  const std::uint64_t other = bench.loaded("c");
  bench.host.on_stop = [&] {
    bench.host.observer->on_crashed(killed, {0, 9, "SIGKILL", {}, {}, {}, false});
    CHECK(bench.recorder.last().event_type == kUnloaded && bench.recorder.last().signal == 9);
    bench.host.observer->on_crashed(faulty, {0, 11, "SIGSEGV", {}, {}, {}, false});
    CHECK(bench.recorder.last().event_type == ComponentEvent::CRASHED);
    CHECK(contains(bench.recorder.last().error_message, "it did not leave in order"));
  };
  bench.manager.begin_stop([] {});
  CHECK(bench.host.unloads == std::vector{other});
}

void test_snapshots() {
  Bench bench;
  const std::uint64_t first = bench.load("a");
  const std::uint64_t second = bench.loaded("b");
  bench.host.observer->on_constructing(first, {1, 2}, CLOCK_PROCESS_CPUTIME_ID);
  const auto all = bench.manager.nodes();
  CHECK(all.size() == 2 && all[0].entry.unique_id == first && all[1].entry.unique_id == second);
  CHECK(all[0].cpu_time_ns > 0 && all[0].elapsed_ns > 0 && all[1].cpu_time_ns == 0);
  const std::vector<std::uint64_t> asked{second, 99};
  CHECK(bench.manager.nodes(asked).size() == 1);
}

}  // namespace

int main() {
  test_load_and_unload();
  test_failures();
  test_unloading_that_cannot_start();
  test_cancel();
  test_crash();
  test_deaths_of_nodes_that_nobody_wants();
  test_names();
  test_death_while_loading();
  test_stop();
  test_nodes_that_end_as_soon_as_they_spin_no_more();
  test_snapshots();
  return 0;
}
