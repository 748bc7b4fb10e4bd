#include "isolation/memory/private_memory.hpp"

#include <sys/mman.h>
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <limits>
#include <new>

#include "isolation/record/child_record.hpp"

namespace play_launch::isolation {
namespace {

/// The least that is given out at once. Addresses only: what is not touched takes no memory.
constexpr std::size_t kUnit = std::size_t{1} << 16;
/// From so many bytes on, a block's memory goes back to the kernel at once.
constexpr std::size_t kLarge = std::size_t{1} << 20;
/// How much more becomes accessible at a time.
constexpr std::size_t kStep = std::size_t{1} << 20;
/// Larger pieces are blocks of their own.
constexpr std::size_t kLargestPooled = kUnit / 4;

/// Where some is mapped, for threads that may not read it. More of them are not listed.
struct Place {
  std::atomic<std::uintptr_t> begin{0};  // 0: nothing
  std::atomic<std::uintptr_t> end{0};
};
std::array<Place, kMaxChildren> places;

void enlist(std::uintptr_t begin, std::size_t size) noexcept {
  for (Place& place : places) {
    std::uintptr_t nothing = 0;
    if (place.begin.compare_exchange_strong(nothing, begin)) {
      place.end = begin + size;
      return;
    }
  }
}

void strike_off(std::uintptr_t begin) noexcept {
  for (Place& place : places) {
    if (place.begin == begin) {
      place.end = 0;
      place.begin = 0;
      return;
    }
  }
}

constexpr std::size_t round_up(std::size_t size, std::size_t step) noexcept {
  return (size + step - 1) / step * step;
}

/// Where addresses are limited (ulimit -v), each node takes a small part: stacks and the allocator
/// need some, too.
std::size_t fair_share() noexcept {
  constexpr rlim_t kShares = 64;
  rlimit limit{};
  const bool is_limited = ::getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY;
  return is_limited ? limit.rlim_cur / kShares : PrivateMemory::kReserve;
}

/// Addresses without memory, at a multiple of kMaxAlignment; null: they are not to be had.
char* reserve_addresses(std::size_t size) noexcept {
  constexpr std::size_t kMargin = PrivateMemory::kMaxAlignment;
  void* const mapping = ::mmap(nullptr, size + kMargin, PROT_NONE,
                               MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (mapping == MAP_FAILED) {
    return nullptr;
  }
  auto* const from = static_cast<char*>(mapping);
  const std::size_t before = round_up(reinterpret_cast<std::uintptr_t>(from), kMargin) -
                             reinterpret_cast<std::uintptr_t>(from);
  char* const begin = from + before;
  if (before > 0) {
    ::munmap(from, before);
  }
  if (before < kMargin) {
    ::munmap(begin + size, kMargin - before);
  }
  return begin;
}

}  // namespace

PrivateMemory::Owner PrivateMemory::create(int key, std::size_t reserve) noexcept {
  const std::size_t share = std::max(fair_share(), kMinimalReserve);
  for (std::size_t size = reserve; size >= kMinimalReserve; size /= 4) {
    if (size > share) {
      continue;
    }
    char* const begin = reserve_addresses(size);
    if (begin == nullptr) {
      continue;
    }
    const std::size_t units_at = round_up(sizeof(PrivateMemory), alignof(Buddies::Unit));
    const std::size_t own = units_at + size / kUnit * sizeof(Buddies::Unit);
    const std::size_t ready = std::min(round_up(own, kStep), size);
    if (protect_pages(begin, ready, key) == 0) {
      auto* const units = reinterpret_cast<Buddies::Unit*>(begin + units_at);
      enlist(reinterpret_cast<std::uintptr_t>(begin), size);
      return Owner(new (begin) PrivateMemory(size, ready, units, key));
    }
    ::munmap(begin, size);
  }
  return nullptr;
}

PrivateMemory::PrivateMemory(std::size_t size, std::size_t ready, Buddies::Unit* units,
                             int key) noexcept
    : size_(size),
      blocks_(begin(), size, ready, units, key),
      pool_({.max_blocks_per_chunk = 0, .largest_required_pool_block = kLargestPooled}, &blocks_) {}

void PrivateMemory::Release::operator()(PrivateMemory* memory) const noexcept {
  strike_off(reinterpret_cast<std::uintptr_t>(memory));
  // Not destroyed: it holds nothing but what is in it.
  ::munmap(memory->begin(), memory->size_);
}

void PrivateMemory::begin_cleanup() noexcept {
  new (&mutex_) std::mutex;  // the holder of the other one is dead
  is_being_destroyed_ = true;
}

void PrivateMemory::keep(Owner memory) noexcept {
  protect_pages(memory->begin(), memory->blocks_.ready(), kCommonKey);
  strike_off(reinterpret_cast<std::uintptr_t>(memory.get()));
  static_cast<void>(memory.release());
}

bool PrivateMemory::contains(std::uintptr_t address) const noexcept {
  const auto first = reinterpret_cast<std::uintptr_t>(begin());
  return first <= address && address - first < size_;
}

void* PrivateMemory::do_allocate(std::size_t size, std::size_t alignment) {
  is_entered_ = true;
  if (is_being_destroyed_) {
    return std::pmr::new_delete_resource()->allocate(size, alignment);
  }
  const std::lock_guard lock(mutex_);
  return pool_.allocate(size, alignment);
}

void PrivateMemory::do_deallocate(void* place, std::size_t size, std::size_t alignment) {
  is_entered_ = true;
  if (is_being_destroyed_) {
    return;
  }
  const std::lock_guard lock(mutex_);
  pool_.deallocate(place, size, alignment);
}

PrivateMemory::Blocks::Blocks(char* begin, std::size_t size, std::size_t ready,
                              Buddies::Unit* units, int key) noexcept
    : begin_(begin),
      size_(size),
      ready_(ready),
      key_(key),
      buddies_(units, order_for(size / kUnit)) {
  // The first block is what this lies in.
  static_cast<void>(buddies_.take(order_for(round_up(ready, kUnit) / kUnit)));
}

void* PrivateMemory::Blocks::do_allocate(std::size_t size, std::size_t alignment) {
  const std::size_t room = std::max({size, alignment, std::size_t{1}});
  if (room > size_ || alignment > kMaxAlignment) {
    throw std::bad_alloc();
  }
  const unsigned order = order_for(round_up(room, kUnit) / kUnit);
  const auto block = buddies_.take(order);
  if (!block) {
    throw std::bad_alloc();
  }
  const std::size_t offset = std::size_t{*block} * kUnit;
  if (!make_ready(offset + room)) {
    buddies_.give_back(*block, order);
    throw std::bad_alloc();
  }
  return begin_ + offset;
}

void PrivateMemory::Blocks::do_deallocate(void* place, std::size_t size, std::size_t alignment) {
  const std::size_t room = std::max({size, alignment, std::size_t{1}});
  const std::size_t units = round_up(room, kUnit) / kUnit;
  if (room >= kLarge) {
    ::madvise(place, units * kUnit, MADV_DONTNEED);
  }
  const auto offset = static_cast<std::size_t>(static_cast<char*>(place) - begin_);
  buddies_.give_back(static_cast<std::uint32_t>(offset / kUnit), order_for(units));
}

/// Pages become accessible from the front on, so that there are two mappings and not one a block.
bool PrivateMemory::Blocks::make_ready(std::size_t end) noexcept {
  if (end <= ready_) {
    return true;
  }
  const std::size_t next = std::min(round_up(end, kStep), size_);
  if (protect_pages(begin_ + ready_, next - ready_, key_) != 0) {
    return false;
  }
  ready_ = next;
  return true;
}

}  // namespace play_launch::isolation

/// For components, see play_launch/private_memory.hpp.
extern "C" std::pmr::memory_resource* play_launch_private_memory() noexcept {
  const play_launch::isolation::ChildRecord* const child = play_launch::isolation::current_child();
  return child != nullptr && child->options.private_memory != nullptr
             ? child->options.private_memory
             : std::pmr::new_delete_resource();
}

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
