#include "main/memory_map.hpp"

#include <fcntl.h>
#include <linux/prctl.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <optional>

#include "base/unique_fd.hpp"

namespace play_launch::container {
namespace {

/// As the kernel has it for this process: only all of it can be set without privileges.
std::optional<prctl_mm_map> own_map() {
  const UniqueFd file(::open("/proc/self/stat", O_RDONLY | O_CLOEXEC));
  std::array<char, 2048> text{};
  const ssize_t size = file ? ::read(file.get(), text.data(), text.size() - 1) : -1;
  const char* const name_end = size > 0 ? std::strrchr(text.data(), ')') : nullptr;
  if (name_end == nullptr) {
    return std::nullopt;
  }
  // The numbers that proc_pid_stat(5) gives the fields; the one after the name is 3.
  prctl_mm_map map{};
  const auto field = [&](int wanted) -> __u64 {
    const char* at = name_end + 1;
    for (int number = 3; number < wanted && at != nullptr; ++number) {
      at = std::strchr(at + 1, ' ');
    }
    return at == nullptr ? 0 : std::strtoull(at, nullptr, 10);
  };
  map.start_code = field(26);
  map.end_code = field(27);
  map.start_stack = field(28);
  map.start_data = field(45);
  map.end_data = field(46);
  map.start_brk = field(47);
  map.arg_start = field(48);
  map.arg_end = field(49);
  map.env_start = field(50);
  map.env_end = field(51);
  map.brk = reinterpret_cast<std::uintptr_t>(::sbrk(0));
  map.exe_fd = ~0U;
  return map;
}

bool set(const prctl_mm_map& map) {
  return ::prctl(PR_SET_MM, PR_SET_MM_MAP, &map, sizeof map, 0) == 0;
}

}  // namespace

bool can_show_commands() {
  const auto map = own_map();
  return map && set(*map);
}

bool show_command(const Command& command) {
  auto map = own_map();
  if (!map) {
    return false;
  }
  const auto address = [](const char* at) { return reinterpret_cast<std::uintptr_t>(at); };
  const char* const end = command.text.data() + command.text.size();
  const char* const environment =
      command.environment.front() == nullptr ? end : command.environment.front();
  map->arg_start = address(command.argv.front());
  map->arg_end = map->env_start = address(environment);
  map->env_end = address(end);
  return set(*map);
}

}  // namespace play_launch::container
