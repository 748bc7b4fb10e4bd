#include "base/process_identity.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstring>

#include "base/unique_fd.hpp"

namespace play_launch {
namespace {

// Without the allocator and stdio: children call it before anything else.
std::uint64_t start_time_in(const char* stat_path) noexcept {
  const UniqueFd file(::open(stat_path, O_RDONLY | O_CLOEXEC));
  std::array<char, 512> text{};
  const ssize_t size = file ? ::read(file.get(), text.data(), text.size() - 1) : -1;
  // Field 2 is the command in parentheses and may hold spaces and parentheses itself: count from
  // its end.
  const char* field = size > 0 ? std::strrchr(text.data(), ')') : nullptr;
  constexpr int kFieldsAfterCommand = 22 - 2;
  for (int i = 0; field != nullptr && i < kFieldsAfterCommand; ++i) {
    field = std::strchr(field + 1, ' ');
  }
  std::uint64_t value = 0;
  if (field != nullptr) {
    for (++field; *field >= '0' && *field <= '9'; ++field) {
      value = value * 10 + static_cast<std::uint64_t>(*field - '0');
    }
  }
  return value;
}

}  // namespace

ProcessIdentity identity_of(pid_t pid) noexcept {
  std::array<char, 32> path{};
  std::snprintf(path.data(), path.size(), "/proc/%d/stat", pid);
  return {pid, start_time_in(path.data())};
}

std::uint64_t start_time_of_self() noexcept { return start_time_in("/proc/self/stat"); }

}  // namespace play_launch
