// spawn_guard PARENT_PID -- COMMAND ARGS...
//
// Becomes COMMAND in a process that the kernel kills when its parent dies. The steps between fork
// and exec are here, in a program of its own, because a supervisor written in Python may run no
// code of its own there (its other threads hold locks at the time of the fork).
//
// spawn_guard --session FD [-- COMMAND ARGS...]
//
// Starts commands for the supervisor at the other end of the socket FD, and ends everything that
// came of them when the supervisor is gone, see session.hpp. If it is gone because it died, COMMAND
// is started then.

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "spawn_guard/command_file.hpp"
#include "spawn_guard/session.hpp"

namespace {

using play_launch::guard::kRefused;

constexpr int kFirstCommandArg = 3;

/// 0 when `text` is no positive number.
int parse_number(const char* text) {
  char* end = nullptr;
  errno = 0;
  const long value = std::strtol(text, &end, 10);
  const bool whole = end != text && *end == '\0';
  return errno == 0 && whole && value > 0 && value <= 0x7fffffff ? static_cast<int>(value) : 0;
}

}  // namespace

int main(int argc, char** argv) {
  const bool has_last = argc > kFirstCommandArg + 1 && std::strcmp(argv[3], "--") == 0;
  if ((argc == kFirstCommandArg || has_last) && std::strcmp(argv[1], "--session") == 0 &&
      parse_number(argv[2]) != 0) {
    return play_launch::guard::guard_session(parse_number(argv[2]),
                                             has_last ? argv + kFirstCommandArg + 1 : nullptr);
  }
  const pid_t parent = argc > kFirstCommandArg ? parse_number(argv[1]) : 0;
  if (parent == 0 || std::strcmp(argv[2], "--") != 0) {
    std::fprintf(stderr,
                 "usage: spawn_guard PARENT_PID -- COMMAND [ARGS...]\n"
                 "       spawn_guard --session FD [-- COMMAND ARGS...]\n");
    return kRefused;
  }
  if (!play_launch::guard::tie_to(parent, argv[kFirstCommandArg])) {
    return kRefused;
  }
  return play_launch::guard::become(argv + kFirstCommandArg);
}
