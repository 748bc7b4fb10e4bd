#include "isolation/clone/vm_clone.hpp"

#include <linux/sched.h>
#include <pthread.h>
#include <signal.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>

#include "base/urgency.hpp"
#include "isolation/clone/clone_syscall.hpp"
#include "isolation/clone/donor_state.hpp"
#include "isolation/record/own_signals.hpp"

namespace play_launch::isolation {
namespace {

// By clone() and not by clone3(), which container runtimes' filters often forbid, but for a child
// that is born in another control group, which clone() cannot do.
//
// No signal at its death: its parent waits already, and it is out of reach
// for a wait() that some library in the container calls for any child. No CLONE_FS: a node's
// working directory and umask are its own.
constexpr unsigned long kFlags = CLONE_VM | CLONE_FILES;

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

/// The process's pid once it has ended, or a negative errno.
long make_process(Start& start, Birth* birth) noexcept {
  if (birth != nullptr && birth->group >= 0) {
    clone_args arguments{};
    arguments.flags = kFlags | CLONE_INTO_CGROUP;
    arguments.cgroup = static_cast<std::uint64_t>(birth->group);
    birth->in_group = true;
    const long pid =
        play_launch_clone_on_own_stack(SYS_clone3, reinterpret_cast<unsigned long>(&arguments),
                                       sizeof arguments, start_child, &start);
    if (pid > 0) {
      return pid;
    }
    birth->in_group = false;
  }
  return play_launch_clone_on_own_stack(SYS_clone, kFlags, 0, start_child, &start);
}

/// Once per address space, the C library installs the handler by which pthread_cancel() works. A
/// process that comes later and never got it dies of that signal.
void install_cancel_handler() {
  pthread_t thread{};
  // With cancellation off, nothing is sent: it ends also where no signal can be queued (ulimit -i).
  const auto cancel_itself = [](void*) -> void* {
    ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, nullptr);
    ::pthread_cancel(::pthread_self());
    return nullptr;
  };
  if (::pthread_create(&thread, nullptr, cancel_itself, nullptr) == 0) {
    ::pthread_join(thread, nullptr);
  }
}

}  // namespace

ChildEnd clone_and_wait(CloneEntry entry, void* argument, void (*before_reaping)(void*),
                        Birth* birth) noexcept {
  const DonorState donor;
  Start start{entry, argument, donor};
  ChildEnd end;
  const long pid = make_process(start, birth);
  if (pid < 0) {
    end.error = static_cast<int>(-pid);
    return end;
  }
  end.pid = static_cast<pid_t>(pid);
  if (before_reaping != nullptr) {
    before_reaping(argument);
  }
  siginfo_t info{};
  const NotRealTime reaping;
  while (::waitid(P_PID, static_cast<id_t>(end.pid), &info, WEXITED | __WALL) != 0) {
    if (errno != EINTR) {
      end.error = errno;
      break;
    }
  }
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

const char* prepare_clone() {
  static const char* const obstacle = [] {
    install_cancel_handler();
    return DonorState::prepare();
  }();
  return obstacle;
}

}  // namespace play_launch::isolation
