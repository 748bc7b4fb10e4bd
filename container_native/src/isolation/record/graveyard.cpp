#include "isolation/record/graveyard.hpp"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>

namespace play_launch::isolation {
namespace {

constexpr std::size_t kGraves = 4096;

// Written by donors and threads of children, which may be killed amidst it: no locks.
struct Place {
  std::atomic<pid_t> thread{0};
  std::atomic<pid_t> process{0};
  std::array<std::atomic<std::uint64_t>, 2> name{};
};

std::array<Place, kGraves> places;
std::atomic<std::size_t> dug{0};

std::size_t used() { return std::min<std::size_t>(dug, kGraves); }

}  // namespace

void bury(pid_t thread, pid_t process, std::string_view process_name) noexcept {
  std::array<char, 16> name{};
  std::copy_n(process_name.data(), std::min(process_name.size(), name.size() - 1), name.data());
  const auto words = std::bit_cast<std::array<std::uint64_t, 2>>(name);
  Place& place = places[dug.fetch_add(1) % kGraves];
  place.thread = 0;
  place.process = process;
  place.name[0] = words[0];
  place.name[1] = words[1];
  place.thread = thread;
}

void rise(pid_t thread) noexcept {
  const std::size_t end = used();
  for (std::size_t i = 0; i < end; ++i) {
    pid_t expected = thread;
    // Each thread of a node looks when it begins; hardly one of them is in the list.
    if (places[i].thread.load(std::memory_order_relaxed) == thread) {
      places[i].thread.compare_exchange_strong(expected, 0);
    }
  }
}

std::optional<Grave> find_grave(pid_t thread) noexcept {
  const std::size_t end = used();
  for (std::size_t i = 0; i < end; ++i) {
    const Place& place = places[i];
    if (place.thread != thread) {
      continue;
    }
    Grave grave{thread, place.process, {}};
    grave.process_name = std::bit_cast<std::array<char, 16>>(
        std::array<std::uint64_t, 2>{place.name[0], place.name[1]});
    if (place.thread == thread) {
      return grave;
    }
  }
  return std::nullopt;
}

}  // namespace play_launch::isolation
