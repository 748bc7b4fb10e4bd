// The decisions about nodes: names, attempts, and the end of a node that is not wanted.

#include "manager/node_table.hpp"

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::container;
using Retirement = NodeTable::Retirement;

namespace {

const play_launch::ProcessIdentity kProcess{100, 200};

SteadyTime at(int seconds) { return SteadyTime(std::chrono::seconds(seconds)); }

std::uint64_t accept(NodeTable& table, const std::string& name, std::uint64_t attempt = 0) {
  const auto acceptance = table.accept({attempt, "package", "ns::Plugin", name}, kProcess, at(0));
  CHECK(!acceptance.repeated && !acceptance.conflict);
  return acceptance.unique_id;
}

std::uint64_t load(NodeTable& table, const std::string& name) {
  const std::uint64_t unique_id = accept(table, name);
  CHECK(table.loaded(unique_id, name, at(1)));
  return unique_id;
}

void test_life() {
  NodeTable table;
  const std::uint64_t unique_id = accept(table, "/a", 7);
  CHECK(unique_id == 1);
  table.constructing(unique_id, {300, 400}, 5);
  const NodeEntry* entry = table.find(unique_id);
  CHECK(entry->state == NodeState::constructing && entry->process.pid == 300);
  CHECK(entry->attempt == 7 && entry->plugin_name == "ns::Plugin" && entry->cpu_clock == 5);
  CHECK(table.loaded(unique_id, "/a", at(3)));
  CHECK(entry->state == NodeState::loaded && entry->since == at(3) && !entry->cpu_clock);
  CHECK(table.retire(unique_id, "", at(4)) == Retirement::unload_now);
  CHECK(entry->state == NodeState::unloading && entry->since == at(4));
  CHECK(table.retire(unique_id, "again", at(5)) == Retirement::under_way);
  const auto removed = table.remove(unique_id);
  CHECK(removed && removed->verdict.empty());
  CHECK(table.entries().empty() && !table.remove(unique_id));
  CHECK(table.retire(unique_id, "", at(6)) == Retirement::unknown);
  CHECK(accept(table, "/a") == 2);  // numbers are never used twice
}

void test_names() {
  NodeTable table;
  const std::uint64_t first = accept(table, "/a");
  for (const bool loaded : {false, true}) {
    if (loaded) {
      CHECK(table.loaded(first, "/a", at(1)));
    }
    const auto second = table.accept({0, "package", "ns::Plugin", "/a"}, kProcess, at(2));
    CHECK(second.conflict && contains(*second.conflict, "/a"));
    CHECK(contains(*second.conflict, loaded ? "is loaded" : "constructing"));
    CHECK(table.find(second.unique_id) == nullptr);
  }
  // Not known before construction: any number of them.
  const std::uint64_t third = accept(table, "");
  CHECK(table.loaded(third, "/a", at(3)));
  CHECK(table.find(third)->state == NodeState::loaded && table.find(third)->full_name == "/a");
  table.remove(third);
  // The name is free when its node is gone, not before.
  CHECK(table.retire(first, "", at(3)) == Retirement::unload_now);
  CHECK(table.accept({0, "package", "ns::Plugin", "/a"}, kProcess, at(4)).conflict);
  table.remove(first);
  load(table, "/a");
}

void test_attempts() {
  NodeTable table;
  const std::uint64_t unique_id = accept(table, "/a", 9);
  const auto again = table.accept({9, "package", "ns::Plugin", "/a"}, kProcess, at(1));
  CHECK(again.repeated && again.unique_id == unique_id && !again.conflict);
  table.remove(unique_id);
  CHECK(table.accept({9, "package", "ns::Plugin", "/a"}, kProcess, at(2)).repeated);
  // Only the latest are remembered.
  for (std::uint64_t attempt = 10; attempt < 10 + NodeTable::kMaxAttempts; ++attempt) {
    table.remove(accept(table, "", attempt));
  }
  CHECK(!table.accept({9, "package", "ns::Plugin", "/a"}, kProcess, at(3)).repeated);
}

void test_retired_while_constructing() {
  NodeTable table;
  const std::uint64_t before = accept(table, "/a");
  CHECK(table.retire(before, "cancelled", at(1)) == Retirement::when_built);
  CHECK(table.find(before)->state == NodeState::constructing);
  CHECK(!table.loaded(before, "/b", at(2)));
  CHECK(table.find(before)->state == NodeState::unloading);
  CHECK(table.find(before)->full_name == "/b");
  const auto removed = table.remove(before);
  CHECK(removed->verdict == "cancelled");
  // Cancelled is cancelled, whatever name it turns out to have.
  load(table, "/c");
  const std::uint64_t namesake = accept(table, "");
  CHECK(table.retire(namesake, "cancelled", at(3)) == Retirement::when_built);
  CHECK(!table.loaded(namesake, "/c", at(4)));
  CHECK(table.remove(namesake)->verdict == "cancelled");
}

void test_kept() {
  NodeTable table;
  const std::uint64_t unique_id = load(table, "/a");
  CHECK(table.retire(unique_id, "", at(2)) == Retirement::unload_now);
  table.keep(unique_id, at(3));
  CHECK(table.find(unique_id)->state == NodeState::loaded);
  CHECK(table.retire(unique_id, "", at(4)) == Retirement::unload_now);
}

void test_bounded() {
  NodeTable table;
  for (std::size_t i = 0; i < NodeTable::kMaxNodes; ++i) {
    CHECK(!table.full());
    accept(table, "");
  }
  CHECK(table.full());
}

}  // namespace

int main() {
  test_life();
  test_names();
  test_attempts();
  test_retired_while_constructing();
  test_kept();
  test_bounded();
  return 0;
}
