#include "isolation/clone/probe.hpp"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdio>

#include "base/unique_fd.hpp"
#include "isolation/clone/vm_clone.hpp"

namespace play_launch::isolation {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// For all of it. Where a filter forbids waitid(), clone_and_wait() never returns.
constexpr auto kLimit = 5s;
/// waitid() by descriptor, for C libraries that lack the name.
constexpr auto kByDescriptor = static_cast<idtype_t>(3);

/// A core is handled up to the point where it would be written. Not 0: programs that get cores
/// through a pipe get those, too.
void write_no_cores() noexcept {
  rlimit limit{};
  ::getrlimit(RLIMIT_CORE, &limit);
  limit.rlim_cur = limit.rlim_max = std::min<rlim_t>(limit.rlim_max, 1);
  ::setrlimit(RLIMIT_CORE, &limit);
}

void answer(int fd, int result) noexcept {
  [[maybe_unused]] const ssize_t written = ::write(fd, &result, sizeof result);
}

/// The forked process: the errno of making a child that ends in order, then 0 after one that
/// crashed, as far as it gets. Begins when the other end of `go` is closed.
[[noreturn]] void try_out(int fd, int go) noexcept {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  char byte = 0;
  while (::read(go, &byte, 1) < 0 && errno == EINTR) {
  }
  write_no_cores();
  const ChildEnd orderly = clone_and_wait([](void*) { return 0; }, nullptr);
  answer(fd, orderly.error);
  if (orderly.error == 0) {
    clone_and_wait([](void*) { return -SIGABRT; }, nullptr);
    answer(fd, 0);
  }
  ::_exit(0);
}

/// False: it said nothing before that time, or ended.
bool hear(int fd, int& result, Clock::time_point end) noexcept {
  pollfd readable{fd, POLLIN, 0};
  int count = 0;
  do {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(end - Clock::now());
    count = ::poll(&readable, 1, std::max(static_cast<int>(left.count()), 0));
  } while (count < 0 && errno == EINTR);
  return count > 0 && ::read(fd, &result, sizeof result) == sizeof result;
}

/// 0, or an errno.
int try_reading_syscall(pid_t pid) noexcept {
  std::array<char, 64> path{};
  std::snprintf(path.data(), path.size(), "/proc/%d/task/%d/syscall", pid, pid);
  const UniqueFd file(::open(path.data(), O_RDONLY | O_CLOEXEC));
  char byte = 0;
  return file && ::read(file.get(), &byte, 1) >= 0 ? 0 : errno;
}

/// Whether it could be done by descriptor.
bool reap(pid_t pid) noexcept {
  const UniqueFd process(static_cast<int>(::syscall(SYS_pidfd_open, pid, 0)));
  siginfo_t info{};
  while (process &&
         ::waitid(kByDescriptor, static_cast<id_t>(process.get()), &info, WEXITED) != 0) {
    if (errno != EINTR) {
      break;
    }
  }
  if (info.si_pid == pid) {
    return true;
  }
  while (::waitpid(pid, nullptr, 0) < 0 && errno == EINTR) {
  }
  return false;
}

}  // namespace

Probe probe_machine() noexcept {
  Probe probe;
  int ends[2] = {-1, -1};
  int start[2] = {-1, -1};
  if (::pipe2(ends, O_CLOEXEC) != 0) {
    probe.clone_error = errno;
    return probe;
  }
  const UniqueFd reading(ends[0]);
  UniqueFd writing(ends[1]);
  if (::pipe2(start, O_CLOEXEC) != 0) {
    probe.clone_error = errno;
    return probe;
  }
  UniqueFd waiting(start[0]);
  UniqueFd go(start[1]);
  const pid_t pid = ::fork();
  if (pid == 0) {
    go.reset();
    try_out(writing.get(), waiting.get());
  }
  probe.clone_error = pid < 0 ? errno : 0;
  writing.reset();
  if (pid > 0) {
    probe.syscall_error = try_reading_syscall(pid);
    go.reset();
    int result = 0;
    const auto end = Clock::now() + kLimit;
    if (hear(reading.get(), probe.clone_error, end)) {
      probe.shares_memory = probe.clone_error == 0;
      probe.survives_crash = probe.shares_memory && hear(reading.get(), result, end);
    }
    ::kill(pid, SIGKILL);  // it has ended, unless it was not heard in time
    probe.waits_by_descriptor = reap(pid);
  }
  return probe;
}

}  // namespace play_launch::isolation
