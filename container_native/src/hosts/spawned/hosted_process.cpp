#include "hosts/spawned/hosted_process.hpp"

#include <signal.h>
#include <spawn.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <string_view>
#include <system_error>

#include "base/urgency.hpp"

namespace play_launch::container {
namespace {

constexpr const char* kProgram = "/proc/self/exe";
constexpr const char* kSocketVariable = "PLAY_LAUNCH_CONTROL_FD";
/// waitid() by descriptor, for C libraries that lack the name.
constexpr auto kByDescriptor = static_cast<idtype_t>(3);

[[noreturn]] void fail(int error, const char* what) {
  throw std::system_error(error, std::generic_category(), what);
}

/// What the new process changes about itself before it becomes another program.
class SpawnPlan {
 public:
  explicit SpawnPlan(int inherited_fd) {
    ::posix_spawn_file_actions_init(&actions_);
    ::posix_spawnattr_init(&attributes_);
    // Onto itself: that clears the flag which would close it.
    ::posix_spawn_file_actions_adddup2(&actions_, inherited_fd, inherited_fd);
    sigset_t none;
    sigemptyset(&none);
    sigset_t all;
    sigfillset(&all);
    ::posix_spawnattr_setsigmask(&attributes_, &none);
    ::posix_spawnattr_setsigdefault(&attributes_, &all);
    ::posix_spawnattr_setflags(&attributes_, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
  }
  ~SpawnPlan() {
    ::posix_spawn_file_actions_destroy(&actions_);
    ::posix_spawnattr_destroy(&attributes_);
  }
  SpawnPlan(const SpawnPlan&) = delete;
  SpawnPlan& operator=(const SpawnPlan&) = delete;

  const posix_spawn_file_actions_t* actions() const { return &actions_; }
  const posix_spawnattr_t* attributes() const { return &attributes_; }

 private:
  posix_spawn_file_actions_t actions_{};
  posix_spawnattr_t attributes_{};
};

/// The environment with that control channel.
std::vector<std::string> environment(int control_fd) {
  const std::string prefix = std::string(kSocketVariable) + "=";
  std::vector<std::string> entries{prefix + std::to_string(control_fd)};
  for (char** entry = environ; *entry != nullptr; ++entry) {
    if (!std::string_view(*entry).starts_with(prefix)) {
      entries.emplace_back(*entry);
    }
  }
  return entries;
}

std::vector<char*> pointers(std::vector<std::string>& texts) {
  std::vector<char*> result;
  for (std::string& text : texts) {
    result.push_back(text.data());
  }
  result.push_back(nullptr);
  return result;
}

}  // namespace

HostedProcess::HostedProcess(const std::vector<std::string>& arguments,
                             const UniqueFd& control_socket) {
  std::vector<std::string> argv{"component_container"};
  argv.insert(argv.end(), arguments.begin(), arguments.end());
  std::vector<std::string> variables = environment(control_socket.get());
  const SpawnPlan plan(control_socket.get());
  pid_t pid = 0;
  if (const int error = ::posix_spawn(&pid, kProgram, plan.actions(), plan.attributes(),
                                      pointers(argv).data(), pointers(variables).data());
      error != 0) {
    fail(error, "posix_spawn");
  }
  fd_.reset(static_cast<int>(::syscall(SYS_pidfd_open, pid, 0)));
  if (!fd_) {
    const int error = errno;
    ::kill(pid, SIGKILL);  // it is not reaped, so the pid is still its own
    ::waitpid(pid, nullptr, 0);
    fail(error, "pidfd_open");
  }
  identity_ = identity_of(pid);
}

HostedProcess::~HostedProcess() {
  if (!reaped_) {
    signal(SIGKILL);
    siginfo_t info{};
    ::waitid(kByDescriptor, static_cast<id_t>(fd_.get()), &info, WEXITED);
  }
}

void HostedProcess::signal(int number) const {
  ::syscall(SYS_pidfd_send_signal, fd_.get(), number, nullptr, 0);
}

bool HostedProcess::reap() {
  siginfo_t info{};
  const NotRealTime reaping;
  if (reaped_ ||
      ::waitid(kByDescriptor, static_cast<id_t>(fd_.get()), &info, WEXITED | WNOHANG) != 0 ||
      info.si_pid == 0) {
    return reaped_;
  }
  reaped_ = true;
  (info.si_code == CLD_EXITED ? end_.exit_code : end_.signal) = info.si_status;
  return true;
}

}  // namespace play_launch::container
