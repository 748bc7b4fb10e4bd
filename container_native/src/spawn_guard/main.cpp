// spawn_guard PARENT_PID -- COMMAND ARGS...
//
// Becomes COMMAND in a process that the kernel kills when its parent dies. The steps between fork
// and exec are here, in a program of its own, because a supervisor written in Python may run no
// code of its own there (its other threads hold locks at the time of the fork).

#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace {

constexpr int kRefused = 125;    // wrong usage, or the parent is gone
constexpr int kCannotRun = 126;  // COMMAND is there, but cannot be executed
constexpr int kNotFound = 127;   // COMMAND is not there
constexpr int kFirstCommandArg = 3;

/// 0 when `text` is no process id.
pid_t parse_pid(const char* text) {
  char* end = nullptr;
  errno = 0;
  const long value = std::strtol(text, &end, 10);
  const bool whole = end != text && *end == '\0';
  return errno == 0 && whole && value > 0 && value <= 0x7fffffff ? static_cast<pid_t>(value) : 0;
}

/// Ignored signals and a signal mask survive exec; COMMAND gets neither from us.
void reset_signals() {
  for (int number = 1; number < NSIG; ++number) {
    ::signal(number, SIG_DFL);  // fails for SIGKILL, SIGSTOP and the two of libc; nothing to do
  }
  sigset_t none;
  sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
}

}  // namespace

int main(int argc, char** argv) {
  const pid_t parent = argc > kFirstCommandArg ? parse_pid(argv[1]) : 0;
  if (parent == 0 || std::strcmp(argv[2], "--") != 0) {
    std::fprintf(stderr, "usage: spawn_guard PARENT_PID -- COMMAND [ARGS...]\n");
    return kRefused;
  }
  if (::prctl(PR_SET_PDEATHSIG, SIGKILL) != 0) {
    std::perror("spawn_guard: PR_SET_PDEATHSIG");
    return kRefused;
  }
  // The parent may have died before the request above; then nobody would ever kill us. Comparing
  // with 1 is not enough: orphans may go to a subreaper.
  if (::getppid() != parent) {
    std::fprintf(stderr, "spawn_guard: parent %d is gone, not starting %s\n",
                 static_cast<int>(parent), argv[kFirstCommandArg]);
    return kRefused;
  }
  reset_signals();
  ::execvp(argv[kFirstCommandArg], argv + kFirstCommandArg);
  const int error = errno;
  std::fprintf(stderr, "spawn_guard: cannot execute %s: %s\n", argv[kFirstCommandArg],
               std::strerror(error));
  return error == ENOENT ? kNotFound : kCannotRun;
}
