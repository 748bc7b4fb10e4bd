#include "isolation/clone/vm_clone.hpp"

#include <linux/sched.h>
#include <signal.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdint>

#include "isolation/clone/clone_syscall.hpp"
#include "isolation/clone/donor_state.hpp"
#include "isolation/record/own_signals.hpp"

namespace play_launch::isolation {
namespace {

// No signal at its death: nobody has to be told who is not suspended already, and it is out of
// reach for a wait() that some library in the container calls for any child.
constexpr std::uint64_t kFlags = CLONE_VM | CLONE_VFORK | CLONE_FS | CLONE_FILES;

std::atomic<bool> clone3_works{true};
thread_local bool tainted = false;

struct Start {
  CloneEntry entry;
  void* argument;
  const DonorState& donor;
  bool returned = false;
};

int start_child(void* argument) {
  auto& start = *static_cast<Start*>(argument);
  start.donor.adopt();
  const int status = start.entry(start.argument);
  start.returned = true;
  if (status < 0) {
    die_of(-status);
  }
  return status;
}

long make_child(Start& start) noexcept {
  if (clone3_works.load(std::memory_order_relaxed)) {
    clone_args arguments{};
    arguments.flags = kFlags;
    const long pid = play_launch_clone_syscall(SYS_clone3, reinterpret_cast<long>(&arguments),
                                               sizeof arguments, 0, start_child, &start);
    if (pid != -ENOSYS) {
      return pid;
    }
    // Filters of container runtimes answer so to what they do not know.
    clone3_works = false;
  }
  return play_launch_clone_syscall(SYS_clone, static_cast<long>(kFlags), 0, 0, start_child, &start);
}

/// Waits until no thread of the child is left: the donor is woken a little before that.
int wait_for(pid_t pid, siginfo_t& info, int options) noexcept {
  while (::waitid(P_PID, static_cast<id_t>(pid), &info, WEXITED | __WALL | options) != 0) {
    if (errno != EINTR) {
      return errno;
    }
  }
  return 0;
}

}  // namespace

ChildEnd clone_and_wait(CloneEntry entry, void* argument, void (*before_reaping)(void*)) noexcept {
  const DonorState donor;
  Start start{entry, argument, donor};
  ChildEnd end;
  const long pid = make_child(start);
  if (pid < 0) {
    end.error = static_cast<int>(-pid);
    return end;
  }
  end.pid = static_cast<pid_t>(pid);
  siginfo_t info{};
  wait_for(end.pid, info, WNOWAIT);
  if (before_reaping != nullptr) {
    before_reaping(argument);
  }
  end.error = wait_for(end.pid, info, 0);
  end.returned = start.returned;
  tainted = tainted || !end.returned;
  if (info.si_code == CLD_EXITED) {
    end.exit_code = info.si_status;
  } else {
    end.signal = info.si_status;
    end.dumped_core = info.si_code == CLD_DUMPED;
  }
  return end;
}

bool donor_is_tainted() noexcept { return tainted; }

void prepare_clone() { DonorState::prepare(); }

int try_clone() noexcept {
  const ChildEnd end = clone_and_wait([](void*) { return 0; }, nullptr);
  return end.error;
}

}  // namespace play_launch::isolation
