#include "base/early_code.hpp"

#include <link.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <string_view>

namespace play_launch {
namespace {

/// One piece of code.
struct Range {
  std::uintptr_t begin = 0;
  std::uintptr_t end = 0;
};

/// By address.
std::array<Range, 1024> ranges;
std::atomic<std::size_t> count{0};

int add_object(dl_phdr_info* object, std::size_t, void* data) {
  const std::string_view path = object->dlpi_name == nullptr ? "" : object->dlpi_name;
  if (path.empty()) {
    return 0;  // the program
  }
  auto& used = *static_cast<std::size_t*>(data);
  for (int i = 0; i < object->dlpi_phnum && used < ranges.size(); ++i) {
    const ElfW(Phdr)& segment = object->dlpi_phdr[i];
    if (segment.p_type == PT_LOAD && (segment.p_flags & PF_X) != 0) {
      const std::uintptr_t begin = object->dlpi_addr + segment.p_vaddr;
      ranges[used++] = {begin, begin + segment.p_memsz};
    }
  }
  return 0;
}

/// Null: in none of them.
const Range* range_of(const void* address) noexcept {
  const auto place = reinterpret_cast<std::uintptr_t>(address);
  const auto end = ranges.begin() + static_cast<std::ptrdiff_t>(count.load());
  const auto after = std::upper_bound(
      ranges.begin(), end, place,
      [](std::uintptr_t wanted, const Range& range) { return wanted < range.begin; });
  if (after == ranges.begin() || place >= std::prev(after)->end) {
    return nullptr;
  }
  return &*std::prev(after);
}

}  // namespace

void note_early_code() noexcept {
  count = 0;
  std::size_t used = 0;
  ::dl_iterate_phdr(add_object, &used);
  std::sort(ranges.begin(), ranges.begin() + static_cast<std::ptrdiff_t>(used),
            [](const Range& one, const Range& other) { return one.begin < other.begin; });
  count = used;
}

bool is_early_code(const void* address) noexcept { return range_of(address) != nullptr; }

}  // namespace play_launch
