#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

namespace play_launch::isolation {

/// Which parts of a range of memory are free, in units whose size it need not know: blocks of 1, 2,
/// 4, ... units, each at a multiple of its size. What is given back becomes one with its neighbour
/// of the same size (Knuth, The Art of Computer Programming 2.5, "buddy system"). Neither touches
/// the memory nor allocates; not for several threads at a time.
class Buddies {
 public:
  static constexpr unsigned kMostOrders = 32;

  /// What is noted of a unit.
  struct Unit {
    std::uint32_t next;
    std::uint32_t previous;
    std::uint8_t state;
  };

  /// `units`: 2 to the power of `order` of them, all zero, for as long as this exists. They are not
  /// touched before their unit is used. All is free at first.
  Buddies(Unit* units, unsigned order) noexcept;

  /// The first unit of a block of 2 to the power of `order` units; nothing: none is free.
  [[nodiscard]] std::optional<std::uint32_t> take(unsigned order) noexcept;
  /// What take(order) gave.
  void give_back(std::uint32_t block, unsigned order) noexcept;

 private:
  void add(std::uint32_t block, unsigned order) noexcept;
  void remove(std::uint32_t block, unsigned order) noexcept;

  Unit* const units_;
  const unsigned order_;
  /// The free blocks of each order: a list through their first units.
  std::array<std::uint32_t, kMostOrders> first_{};
};

/// The lowest order whose blocks have so many units.
constexpr unsigned order_for(std::size_t units) noexcept {
  unsigned order = 0;
  while ((std::size_t{1} << order) < units) {
    ++order;
  }
  return order;
}

}  // namespace play_launch::isolation
