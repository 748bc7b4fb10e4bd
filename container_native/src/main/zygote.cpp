#include "main/zygote.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <span>
#include <string>
#include <vector>

#include "base/descriptor_message.hpp"
#include "base/number_list.hpp"
#include "main/backends.hpp"
#include "main/fastdds.hpp"
#include "main/memory_map.hpp"
#include "main/same_parent_fork.hpp"
#include "main/tracing_threads.hpp"

namespace play_launch::container {
namespace {

constexpr int kRefused = 125;  // as spawn_guard says when it starts nothing
constexpr int kStandard = 3;   // descriptors that every process has

std::size_t count(const char* folder) {
  std::size_t found = 0;
  NumberList(folder).for_each([&](int) { ++found; });
  return found;
}

/// Nothing may be open but what is known: a library that has opened something would lose it in the
/// child, and no other threads may exist, as they would be missing in it.
bool is_as_expected(std::size_t descriptors, const TracingThreads& tracing) {
  const std::size_t own = 1;  // of the list itself
  return count("/proc/self/fd") == descriptors + own &&
         count("/proc/self/task") == 1 + (tracing.are_there() ? TracingThreads::kCount : 0);
}

/// Closes all from 3 on but those; false when it cannot.
bool close_others(std::vector<int> kept) {
  std::ranges::sort(kept);
  int from = kStandard;
  for (const int fd : kept) {
    if (fd > from &&
        !close_descriptors(static_cast<unsigned>(from), static_cast<unsigned>(fd) - 1, 0)) {
      return false;
    }
    from = std::max(from, fd + 1);
  }
  return close_descriptors(static_cast<unsigned>(from), ~0U, 0);
}

/// What fork and exec would have made of the child. False when it cannot be done.
bool become(Command& command, DescriptorMessage& message, int line, pid_t parent) {
  ::setsid();
  const std::span descriptors(message.descriptors);
  if (!place_descriptors(descriptors.subspan(2), message.numbers)) {
    return false;
  }
  for (UniqueFd& each : message.descriptors) {
    each.release();
  }
  std::vector<int> kept(message.numbers.begin(), message.numbers.end());
  kept.push_back(line);
  if (!close_others(std::move(kept))) {
    return false;
  }
  environ = command.environment.data();
  if (!command.apply_settings() || !show_command(command) ||
      ::prctl(PR_SET_PDEATHSIG, SIGKILL) != 0) {
    return false;
  }
  // The parent may have died before.
  return ::getppid() == parent;
}

/// Waits until the container is wanted.
bool may_begin(int line) {
  const std::array<std::int32_t, 1> ready{::getpid()};
  DescriptorMessage answer;
  return send_message(line, ready) && answer.receive(line);
}

}  // namespace

Command serve_as_zygote(int socket) {
  const pid_t parent = ::getppid();
  TracingThreads tracing;
  // What the libraries of rclcpp do before main() was not looked at: such containers are executed.
  const bool is_known = backend_names() == std::vector<std::string>{"native"};
  if (!is_known || !can_fork_beside_us() || !can_show_commands() ||
      !is_as_expected(kStandard + 1, tracing)) {
    ::_exit(kRefused);
  }
  open_type_supports();
  DescriptorMessage message;
  Command command;
  while (message.receive(socket)) {
    const std::size_t known = kStandard + 1 + message.descriptors.size();
    if (message.descriptors.size() != 2 + message.numbers.size() || message.numbers.empty() ||
        !command.read(message.descriptors[1].get()) || !is_as_expected(known, tracing)) {
      message = {};
      continue;
    }
    tracing.before_fork();
    if (fork_beside_us() != 0) {  // or it failed: the line ends, and that says it
      tracing.after_fork();
      message = {};
      continue;
    }
    // Above every number that the container is going to have.
    const int above = std::ranges::max(message.numbers) + 1;
    const int line = ::fcntl(message.descriptors[0].get(), F_DUPFD_CLOEXEC, above);
    if (line < 0 || !become(command, message, line, parent)) {
      ::_exit(kRefused);
    }
    tracing.in_child();
    if (!may_begin(line)) {
      ::_exit(kRefused);
    }
    ::close(line);
    return command;
  }
  ::_exit(0);
}

}  // namespace play_launch::container
