// Which blocks are given out: pure, against a plain account of the units that are taken.

#include "isolation/memory/buddies.hpp"

#include <random>
#include <utility>
#include <vector>

#include "../container/check.hpp"

namespace {

using play_launch::isolation::Buddies;
using play_launch::isolation::order_for;

constexpr unsigned kOrder = 8;
constexpr std::uint32_t kUnits = 1U << kOrder;

using Block = std::pair<std::uint32_t, unsigned>;

/// Any sequence of takes and returns: blocks are aligned, do not overlap, and are refused only when
/// no aligned place is free.
void keeps_account(unsigned seed) {
  std::mt19937 random(seed);
  std::vector<Buddies::Unit> units(kUnits, Buddies::Unit{});
  Buddies buddies(units.data(), kOrder);
  std::vector<bool> is_taken(kUnits, false);
  std::vector<Block> blocks;
  const auto mark = [&](const Block& block, bool taken) {
    for (std::uint32_t i = 0; i < 1U << block.second; ++i) {
      CHECK(is_taken[block.first + i] != taken);
      is_taken[block.first + i] = taken;
    }
  };
  for (int step = 0; step < 2000; ++step) {
    if (random() % 5 < 3) {
      const unsigned order = random() % (kOrder + 1);
      if (const auto first = buddies.take(order)) {
        CHECK(*first % (1U << order) == 0);
        blocks.emplace_back(*first, order);
        mark(blocks.back(), true);
      } else {
        for (std::uint32_t first_free = 0; first_free < kUnits; first_free += 1U << order) {
          bool any = false;
          for (std::uint32_t i = 0; i < 1U << order; ++i) {
            any = any || is_taken[first_free + i];
          }
          CHECK(any);
        }
      }
    } else if (!blocks.empty()) {
      const std::size_t which = random() % blocks.size();
      const Block block = std::exchange(blocks[which], blocks.back());
      blocks.pop_back();
      mark(block, false);
      buddies.give_back(block.first, block.second);
    }
  }
  for (const Block& block : blocks) {
    buddies.give_back(block.first, block.second);
  }
  CHECK(buddies.take(kOrder) == std::uint32_t{0});  // all is one block again
  CHECK(!buddies.take(0));
}

}  // namespace

int main() {
  CHECK(order_for(1) == 0 && order_for(2) == 1 && order_for(3) == 2 && order_for(1024) == 10);
  for (unsigned seed = 0; seed < 50; ++seed) {
    keeps_account(seed);
  }
}
