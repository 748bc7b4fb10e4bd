#include "base/process.hpp"

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>

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

bool is_stopped(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/stat");
  std::string text;
  std::getline(file, text);
  const std::size_t name_end = text.rfind(") ");
  if (name_end == std::string::npos || name_end + 2 >= text.size()) {
    return false;
  }
  return text[name_end + 2] == 'T' || text[name_end + 2] == 't';
}

std::optional<std::string> other_program_of(pid_t pid) {
  const std::string link = "/proc/" + std::to_string(pid) + "/exe";
  struct stat theirs{};
  struct stat ours{};
  if (::stat(link.c_str(), &theirs) != 0 || ::stat("/proc/self/exe", &ours) != 0 ||
      (theirs.st_dev == ours.st_dev && theirs.st_ino == ours.st_ino)) {
    return std::nullopt;
  }
  std::array<char, 4096> path{};
  const ssize_t length = ::readlink(link.c_str(), path.data(), path.size());
  return length > 0 ? std::string(path.data(), static_cast<std::size_t>(length)) : std::string();
}

void set_core_dumps(bool dumps) noexcept {
  // A limit of 0 does not hold where the kernel hands cores to a program (kernel.core_pattern
  // begins with "|", as on Ubuntu and Fedora); there 1 means none. Files of less than a page are
  // not written at all.
  constexpr rlim_t kNone = 1;
  const int error = errno;
  rlimit limit{};
  if (::getrlimit(RLIMIT_CORE, &limit) == 0) {
    limit.rlim_cur = dumps ? limit.rlim_max : kNone;
    // Raising a hard limit of 0 needs CAP_SYS_RESOURCE.
    limit.rlim_max = std::max(limit.rlim_max, limit.rlim_cur);
    ::setrlimit(RLIMIT_CORE, &limit);
  }
  errno = error;
}

void grow_heap() noexcept {
  // Smaller than what malloc() maps apart; the last one that is freed joins all of them.
  constexpr std::size_t kPart = 120 * 1024;
  std::array<void*, 12> parts{};
  for (void*& part : parts) part = std::malloc(kPart);
  for (void* part : parts) std::free(part);
}

}  // namespace play_launch
