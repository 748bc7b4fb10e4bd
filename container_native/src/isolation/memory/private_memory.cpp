#include "isolation/memory/private_memory.hpp"

#include <sys/mman.h>
#include <sys/resource.h>

#include <algorithm>
#include <bit>
#include <new>
#include <utility>

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

constexpr std::size_t round_up(std::size_t size, std::size_t step) noexcept {
  return (size + step - 1) / step * step;
}

/// Bytes of the block for a piece. More than there can be stay what they are.
std::size_t block_for(std::size_t size, std::size_t alignment) noexcept {
  const std::size_t least = std::max({size, alignment, kUnit});
  return least <= PrivateMemory::kReserve ? std::bit_ceil(least) : least;
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
    const std::size_t ready = round_up(sizeof(PrivateMemory), kStep);
    if (protect_pages(begin, ready, key) == 0) {
      return Owner(new (begin) PrivateMemory(size, ready, key));
    }
    ::munmap(begin, size);
  }
  return nullptr;
}

PrivateMemory::PrivateMemory(std::size_t size, std::size_t ready, int key) noexcept
    : size_(size),
      blocks_(begin(), size, ready, key),
      pool_({.max_blocks_per_chunk = 0, .largest_required_pool_block = kLargestPooled}, &blocks_) {}

void PrivateMemory::Release::operator()(PrivateMemory* memory) const noexcept {
  // Not destroyed: it holds nothing but what is in it.
  ::munmap(memory->begin(), memory->size_);
}

void PrivateMemory::begin_cleanup() noexcept {
  new (&mutex_) std::mutex;  // the holder of the other one is dead
  is_being_destroyed_ = true;
}

void PrivateMemory::keep(Owner memory) noexcept {
  protect_pages(memory->begin(), memory->blocks_.ready(), kCommonKey);
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

PrivateMemory::Blocks::Blocks(char* begin, std::size_t size, std::size_t ready, int key) noexcept
    : begin_(begin),
      size_(size),
      ready_(ready),
      used_(round_up(sizeof(PrivateMemory), kUnit)),
      key_(key) {}

void* PrivateMemory::Blocks::do_allocate(std::size_t size, std::size_t alignment) {
  const std::size_t room = block_for(size, alignment);
  if (room > size_ || alignment > kMaxAlignment) {
    throw std::bad_alloc();
  }
  Free*& first = free_[static_cast<std::size_t>(std::countr_zero(room))];
  if (first != nullptr) {
    return std::exchange(first, first->next);
  }
  const std::size_t offset = round_up(used_, room);
  if (offset + room > size_ || !make_ready(offset + room)) {
    throw std::bad_alloc();
  }
  used_ = offset + room;
  return begin_ + offset;
}

void PrivateMemory::Blocks::do_deallocate(void* place, std::size_t size, std::size_t alignment) {
  const std::size_t room = block_for(size, alignment);
  if (room >= kLarge) {
    ::madvise(place, round_up(size, kUnit), MADV_DONTNEED);
  }
  Free*& first = free_[static_cast<std::size_t>(std::countr_zero(room))];
  first = new (place) Free{first};
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
