#include "spawn_guard/descendants.hpp"

#include <dirent.h>
#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <memory>
#include <string>
#include <system_error>
#include <thread>

#include "base/unique_fd.hpp"

namespace play_launch::guard {

namespace {

struct Process {
  pid_t parent;
  bool is_alive;
};

/// The state and the parent of a process; parent 0 when it is gone.
Process read_process(const char* pid) {
  const std::string path = std::string("/proc/") + pid + "/stat";
  const UniqueFd file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  std::array<char, 512> text{};
  const ssize_t size = file ? ::read(file.get(), text.data(), text.size() - 1) : -1;
  // The command, in parentheses, may itself hold parentheses and spaces.
  const char* end = size > 0 ? std::strrchr(text.data(), ')') : nullptr;
  char state = 0;
  int parent = 0;
  if (end == nullptr || std::sscanf(end + 1, " %c %d", &state, &parent) != 2) {
    return {0, false};
  }
  return {parent, state != 'Z' && state != 'X'};
}

std::map<pid_t, Process> all_processes() {
  std::map<pid_t, Process> found;
  const std::unique_ptr<DIR, int (*)(DIR*)> folder(::opendir("/proc"), ::closedir);
  while (const dirent* entry = folder ? ::readdir(folder.get()) : nullptr) {
    const int pid = std::atoi(entry->d_name);
    if (pid > 0) {
      const Process process = read_process(entry->d_name);
      if (process.parent > 0) {
        found.emplace(pid, process);
      }
    }
  }
  return found;
}

}  // namespace

void kill_descendants(const std::set<pid_t>& spared) {
  const std::map<pid_t, Process> processes = all_processes();
  const pid_t ours = ::getpid();
  std::vector<pid_t> found;
  for (const auto& [pid, process] : processes) {
    pid_t at = pid;
    // Read one after the other, so pids that were reused meanwhile may form a circle.
    for (std::size_t step = 0; step <= processes.size(); ++step) {
      const auto here = processes.find(at);
      if (here == processes.end() || here->second.parent == ours) {
        if (here != processes.end() && !spared.contains(at) && process.is_alive) {
          found.push_back(pid);
        }
        break;
      }
      at = here->second.parent;
    }
  }
  // A pid that is found here belongs to a process that only its parent can wait for, and
  // parents are killed in the same breath: until then, the pid is not reused.
  for (const pid_t pid : found) {
    ::kill(pid, SIGKILL);
  }
}

std::vector<pid_t> children() {
  std::vector<pid_t> found;
  // Complete, as nothing but ourselves takes one out of it meanwhile (proc_pid_task_children(5)).
  if (std::ifstream list("/proc/thread-self/children"); list) {
    found.assign(std::istream_iterator<pid_t>(list), {});
    return found;
  }
  for (const auto& [pid, process] : all_processes()) {  // a kernel without CONFIG_PROC_CHILDREN
    if (process.parent == ::getpid()) {
      found.push_back(pid);
    }
  }
  return found;
}

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
