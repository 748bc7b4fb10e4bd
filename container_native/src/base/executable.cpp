#include "base/executable.hpp"

#include <sys/stat.h>
#include <unistd.h>

#include <array>

namespace play_launch {

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

}  // namespace play_launch
