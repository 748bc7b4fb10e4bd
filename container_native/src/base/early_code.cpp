#include "base/early_code.hpp"

#include <link.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string_view>

namespace play_launch {
namespace {

using namespace std::string_view_literals;

struct Range {
  std::uintptr_t begin = 0;
  std::uintptr_t end = 0;
};

std::array<Range, 512> ranges;
std::atomic<std::size_t> count{0};

// What calls code of nodes: where such a function ends with a call, that returns to its caller.
constexpr std::array kCallers{"ld-"sv,       "libc."sv,           "libpthread"sv,
                              "libstdc++"sv, "libgcc_s"sv,        "libplay_launch_component"sv,
                              "librclcpp"sv, "libclass_loader"sv, "libcomponent_manager"sv};

bool calls_nodes(const char* path) {
  const std::string_view text = path == nullptr ? "" : path;
  const std::string_view name = text.substr(text.rfind('/') + 1);
  return name.empty() || std::ranges::any_of(kCallers, [name](std::string_view caller) {
           return name.starts_with(caller);
         });
}

int add_object(dl_phdr_info* object, std::size_t, void* data) {
  if (calls_nodes(object->dlpi_name)) {
    return 0;
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
