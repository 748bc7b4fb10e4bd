#include "isolation/clone/gate.hpp"

#include <dlfcn.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/utsname.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstring>

#include "base/unique_fd.hpp"
#include "isolation/clone/vm_clone.hpp"
#include "isolation/quiesce/code_map.hpp"
#include "isolation/record/own_signals.hpp"

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
    count = ::poll(&readable, 1, poll_timeout(end));
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

/// Forks that process, and waits for it: milliseconds, at most seconds. No core is written.
Probe try_in_process() noexcept {
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

/// prepare_clone() must have been called. Any thread, but not in a child.
Probe probe_machine() noexcept {
  const Probe probe = try_in_process();
  if (!probe.shares_memory || probe.survives_crash) {
    return probe;
  }
  end_children_by_kill(true);
  Probe again = try_in_process();
  if (!again.survives_crash) {
    end_children_by_kill(false);
    return probe;
  }
  again.ends_by_kill = true;
  return again;
}

bool exists(const char* symbol) { return ::dlsym(RTLD_DEFAULT, symbol) != nullptr; }

/// Whose malloc this program uses, as far as it has a name that matters here.
std::string allocator_in_use() {
  // Loaded is not enough: it must be the one that malloc() is.
  void* const malloc = ::dlsym(RTLD_DEFAULT, "malloc");
  Dl_info place{};
  if (malloc == nullptr || ::dladdr(malloc, &place) == 0 || place.dli_fname == nullptr) {
    return {};
  }
  const std::string library = place.dli_fname;
  for (const char* const name : {"mimalloc", "jemalloc"}) {
    if (library.find(name) != std::string::npos) {
      return name;
    }
  }
  if (exists("mi_malloc") && ::dlsym(RTLD_DEFAULT, "mi_malloc") == malloc) {
    return "mimalloc";
  }
  return {};
}

std::string why_not(const Facts& facts) {
  if (!facts.obstacle.empty()) {
    return facts.obstacle + " (processes cannot share memory then)";
  }
  if (facts.probe.clone_error != 0) {
    return std::string("processes that share memory cannot be made here (clone: ") +
           std::strerror(facts.probe.clone_error) + ")";
  }
  if (!facts.probe.shares_memory) {
    return "processes that share memory cannot be waited for here (does a filter forbid waitid?)";
  }
  if (!facts.probe.survives_crash) {
    return "with Linux " + facts.kernel_release +
           " a crash ends every process that shares the memory";
  }
  return {};
}

Gate with_processes(const Facts& facts) {
  if (!facts.probe.waits_by_descriptor) {
    throw MechanismUnavailable(
        "nodes cannot be isolated here: isolation: process needs pidfd_open (Linux 5.4 or newer, "
        "where no filter forbids it; this is " +
        facts.kernel_release + ")");
  }
  return {};
}

}  // namespace

std::string_view mechanism_name(Mechanism mechanism) {
  return mechanism == Mechanism::shared_memory ? "shared_memory" : "process";
}

Facts look_at_machine() {
  Facts facts;
  utsname system{};
  if (::uname(&system) == 0) {
    facts.kernel_release = system.release;
  }
  if (const char* const obstacle = prepare_clone()) {
    facts.obstacle = obstacle;
  }
  facts.probe = probe_machine();
  facts.allocator = allocator_in_use();
  facts.missing_landmarks = find_landmarks();
  return facts;
}

Gate choose_mechanism(MechanismChoice choice, const Facts& facts) {
  if (choice == MechanismChoice::process) {
    return with_processes(facts);
  }
  const std::string obstacle = why_not(facts);
  if (!obstacle.empty()) {
    if (choice == MechanismChoice::shared_memory) {
      throw MechanismUnavailable("isolation in shared memory was asked for, but " + obstacle +
                                 "; use isolation: process");
    }
    Gate gate = with_processes(facts);
    gate.notes.push_back(obstacle +
                         "; every node is a program of its own instead (isolation: process), and "
                         "messages between nodes are copied through the middleware");
    return gate;
  }
  Gate gate;
  gate.mechanism = Mechanism::shared_memory;
  if (facts.probe.ends_by_kill) {
    gate.limit =
        "with Linux " + facts.kernel_release +
        " a core dump ends every process that shares the memory (since 5.16 it does not): nodes "
        "that crash end by SIGKILL and leave no core, and one that blocks a fatal signal or gives "
        "it its default action takes the container along";
  }
  if (facts.probe.syscall_error != 0) {
    gate.notes.push_back(
        std::string("what threads of nodes wait for cannot be read here "
                    "(/proc/<pid>/task/<tid>/syscall: ") +
        std::strerror(facts.probe.syscall_error) +
        "): a lock that a killed node held is not found, and only reloads that hang show it; set "
        "kernel.yama.ptrace_scope to 0 or 1, and mount /proc without hidepid");
  }
  if (facts.allocator.empty()) {
    gate.notes.push_back(
        "malloc is neither mimalloc nor jemalloc: a node that dies while it allocates can freeze "
        "its whole container, which is then restarted; the supervisor preloads mimalloc where it "
        "finds it (pip install cmeel-mimalloc, or your distribution's); without a supervisor, "
        "start the container with LD_PRELOAD=/path/to/libmimalloc.so");
  }
  if (!facts.missing_landmarks.empty()) {
    std::string names;
    for (const std::string& name : facts.missing_landmarks) {
      names += (names.empty() ? "" : ", ") + name;
    }
    gate.notes.push_back(
        "code of the C and the C++ library is not where it is expected (" + names +
        "): whether a thread of a dying node holds a lock there is not known, and a node that dies "
        "can freeze its whole container, which is then restarted; with isolation: process it "
        "cannot");
  }
  return gate;
}

}  // namespace play_launch::isolation
