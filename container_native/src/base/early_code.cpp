#include "base/early_code.hpp"

#include <link.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace play_launch {
namespace {

struct Range {
  std::uintptr_t begin = 0;
  std::uintptr_t end = 0;
};

std::array<Range, 512> ranges;
std::atomic<std::size_t> count{0};

int add_object(dl_phdr_info* object, std::size_t, void* data) {
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

}  // namespace

void note_early_code() noexcept {
  std::size_t used = 0;
  ::dl_iterate_phdr(add_object, &used);
  count = used;
}

bool is_early_code(const void* address) noexcept {
  const auto place = reinterpret_cast<std::uintptr_t>(address);
  const std::size_t used = count;
  for (std::size_t i = 0; i < used; ++i) {
    if (ranges[i].begin <= place && place < ranges[i].end) {
      return true;
    }
  }
  return false;
}

}  // namespace play_launch
