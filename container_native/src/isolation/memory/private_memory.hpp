#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <memory_resource>
#include <mutex>

#include "isolation/memory/protection_keys.hpp"

namespace play_launch::isolation {

/// The private memory of one node, behind play_launch::private_memory(): a range of addresses with
/// the node's protection key. The object itself lies in it, with its lock and its lists: code that
/// may not write there faults before it has taken or changed anything. Any thread.
class PrivateMemory final : public std::pmr::memory_resource {
 public:
  /// Addresses; memory is taken when it is used.
  static constexpr std::size_t kReserve = std::size_t{1} << 34;
  static constexpr std::size_t kMinimalReserve = std::size_t{1} << 24;
  /// Larger alignments are not to be had.
  static constexpr std::size_t kMaxAlignment = std::size_t{1} << 21;

  /// Gives everything back to the kernel.
  struct Release {
    void operator()(PrivateMemory* memory) const noexcept;
  };
  using Owner = std::unique_ptr<PrivateMemory, Release>;

  /// With `reserve` bytes of addresses, a power of two from kMinimalReserve on, or less where the
  /// process may not have so many. Null: not even the least. kCommonKey: not protected.
  static Owner create(int key, std::size_t reserve = kReserve) noexcept;

  /// The node is dead, and may have died amidst something: nothing is given back any more, and what
  /// is still allocated is ordinary memory. What the node left can be destroyed then.
  void begin_cleanup() noexcept;

  /// Leaves it where it is, under no key, for threads that may still use it. For one whose owner
  /// could not be destroyed.
  static void keep(Owner memory) noexcept;

  bool contains(std::uintptr_t address) const noexcept;

 private:
  /// Whole blocks of 1, 2, 4, ... units, for the pool of smaller pieces. Each is at a multiple of
  /// its size, from the front on; what is given back is used again for blocks of the same size.
  class Blocks final : public std::pmr::memory_resource {
   public:
    Blocks(char* begin, std::size_t size, std::size_t ready, int key) noexcept;
    /// How much of it may be accessed, from the beginning on.
    std::size_t ready() const noexcept { return ready_; }

   private:
    void* do_allocate(std::size_t size, std::size_t alignment) override;
    void do_deallocate(void* place, std::size_t size, std::size_t alignment) override;
    bool do_is_equal(const memory_resource& other) const noexcept override {
      return this == &other;
    }
    bool make_ready(std::size_t end) noexcept;

    /// Lies in the block.
    struct Free {
      Free* next;
    };

    char* const begin_;
    const std::size_t size_;
    std::size_t ready_;
    std::size_t used_;
    const int key_;
    std::array<Free*, 64> free_{};  // by the logarithm of their size
  };

  PrivateMemory(std::size_t size, std::size_t ready, int key) noexcept;

  void* do_allocate(std::size_t size, std::size_t alignment) override;
  void do_deallocate(void* place, std::size_t size, std::size_t alignment) override;
  bool do_is_equal(const memory_resource& other) const noexcept override { return this == &other; }

  char* begin() const noexcept { return reinterpret_cast<char*>(const_cast<PrivateMemory*>(this)); }

  const std::size_t size_;
  /// Written before the lock is taken, by each thread.
  std::atomic<bool> is_entered_{false};
  bool is_being_destroyed_ = false;
  std::mutex mutex_;  // guards what follows
  Blocks blocks_;
  std::pmr::unsynchronized_pool_resource pool_;
};

}  // namespace play_launch::isolation
