#include "spawn_guard/command.hpp"

#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>

namespace play_launch::guard {

namespace {

/// Ignored signals and a signal mask survive exec; the command gets neither from us.
void reset_signals() {
  for (int number = 1; number < NSIG; ++number) {
    ::signal(number, SIG_DFL);  // fails for SIGKILL, SIGSTOP and the two of libc; nothing to do
  }
  sigset_t none;
  sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
}

}  // namespace

bool tie_to(pid_t parent, const char* command) {
  if (::prctl(PR_SET_PDEATHSIG, SIGKILL) != 0) {
    std::perror("spawn_guard: PR_SET_PDEATHSIG");
    return false;
  }
  // The parent may have died before the request above; then no process would ever kill us.
  // Comparing with 1 is not enough: orphans may go to a subreaper.
  if (::getppid() != parent) {
    std::fprintf(stderr, "spawn_guard: parent %d is gone, not starting %s\n",
                 static_cast<int>(parent), command);
    return false;
  }
  return true;
}

bool enter(const char* folder) {
  if (folder == nullptr || ::chdir(folder) == 0) {
    return true;
  }
  std::fprintf(stderr, "spawn_guard: cannot enter %s: %s\n", folder, std::strerror(errno));
  return false;
}

int become(char* const* argv) {
  reset_signals();
  ::execvp(argv[0], argv);
  const int error = errno;
  std::fprintf(stderr, "spawn_guard: cannot execute %s: %s\n", argv[0], std::strerror(error));
  return error == ENOENT ? kNotFound : kCannotRun;
}

}  // namespace play_launch::guard
