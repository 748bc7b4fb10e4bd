#include "spawn_guard/control_group.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <filesystem>
#include <string>
#include <system_error>
#include <thread>

namespace play_launch::guard {

namespace {

using std::chrono::steady_clock;

constexpr std::chrono::seconds kLimit{5};
constexpr std::chrono::milliseconds kRound{2};

/// From below to above; false when a process is still in one of them.
bool remove_tree(const std::filesystem::path& folder) {
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    std::error_code ignored;
    if (entry.is_directory(ignored)) {
      remove_tree(entry.path());
    }
  }
  return ::rmdir(folder.c_str()) == 0 || errno != EBUSY;
}

}  // namespace

void remove_group(const UniqueFd& folder) {
  std::error_code error;
  // Its name: a removed group has none.
  const auto path =
      std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(folder.get()), error);
  const auto deadline = steady_clock::now() + kLimit;
  while (!error && !remove_tree(path) && steady_clock::now() < deadline) {
    const UniqueFd kill(::openat(folder.get(), "cgroup.kill", O_WRONLY | O_CLOEXEC));
    if (!kill || ::write(kill.get(), "1", 1) != 1) {
      return;
    }
    std::this_thread::sleep_for(kRound);
  }
}

}  // namespace play_launch::guard
