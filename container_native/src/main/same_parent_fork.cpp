#include "main/same_parent_fork.hpp"

#include <linux/sched.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstddef>

namespace play_launch::container {
namespace {

/// Where the C library keeps the number of this thread. Mutexes that are recursive or robust have
/// it as their owner, so it has to be right in the child.
int* stored_thread_id() {
  int* id = nullptr;
  const bool known = ::prctl(PR_GET_TID_ADDRESS, &id) == 0 && id != nullptr;
  return known && *id == ::gettid() ? id : nullptr;
}

}  // namespace

bool can_fork_beside_us() { return stored_thread_id() != nullptr; }

pid_t fork_beside_us() {
  int* const id = stored_thread_id();
  void* robust_list = nullptr;
  std::size_t robust_list_size = 0;
  if (id == nullptr || ::syscall(SYS_get_robust_list, 0, &robust_list, &robust_list_size) != 0) {
    return -1;
  }
  // What the C library's fork() does, too; by clone() and not by clone3(), which container
  // runtimes' filters often forbid. The signal at its death is the one that we have ourselves.
  constexpr unsigned long kFlags =
      CLONE_PARENT | CLONE_CHILD_SETTID | CLONE_CHILD_CLEARTID | SIGCHLD;
#if defined(__x86_64__)
  const long pid = ::syscall(SYS_clone, kFlags, nullptr, nullptr, id, nullptr);
#else
  const long pid = ::syscall(SYS_clone, kFlags, nullptr, nullptr, nullptr, id);
#endif
  if (pid == 0) {
    ::syscall(SYS_set_robust_list, robust_list, robust_list_size);
  }
  return static_cast<pid_t>(pid);
}

}  // namespace play_launch::container
