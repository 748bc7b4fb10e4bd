#include "isolation/memory/buddies.hpp"

#include <limits>

namespace play_launch::isolation {
namespace {

constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

// States of a block's first unit; of all others it means nothing.
constexpr std::uint8_t kUsed = 0;
constexpr std::uint8_t free_of(unsigned order) noexcept {
  return static_cast<std::uint8_t>(order + 1);
}

}  // namespace

Buddies::Buddies(Unit* units, unsigned order) noexcept : units_(units), order_(order) {
  first_.fill(kNone);
  add(0, order);
}

std::optional<std::uint32_t> Buddies::take(unsigned order) noexcept {
  unsigned found = order;
  while (found <= order_ && first_[found] == kNone) {
    ++found;
  }
  if (found > order_) {
    return std::nullopt;
  }
  const std::uint32_t block = first_[found];
  remove(block, found);
  while (found > order) {
    --found;
    add(block + (std::uint32_t{1} << found), found);
  }
  return block;
}

void Buddies::give_back(std::uint32_t block, unsigned order) noexcept {
  while (order < order_) {
    const std::uint32_t buddy = block ^ (std::uint32_t{1} << order);
    if (units_[buddy].state != free_of(order)) {
      break;
    }
    remove(buddy, order);
    block = block < buddy ? block : buddy;
    ++order;
  }
  add(block, order);
}

void Buddies::add(std::uint32_t block, unsigned order) noexcept {
  const std::uint32_t next = first_[order];
  units_[block] = {next, kNone, free_of(order)};
  if (next != kNone) {
    units_[next].previous = block;
  }
  first_[order] = block;
}

void Buddies::remove(std::uint32_t block, unsigned order) noexcept {
  const Unit unit = units_[block];
  if (unit.previous == kNone) {
    first_[order] = unit.next;
  } else {
    units_[unit.previous].next = unit.next;
  }
  if (unit.next != kNone) {
    units_[unit.next].previous = unit.previous;
  }
  units_[block].state = kUsed;
}

}  // namespace play_launch::isolation
