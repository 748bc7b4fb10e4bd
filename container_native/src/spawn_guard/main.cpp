// spawn_guard --session FD [-- COMMAND ARGS...]
//
// Starts commands for the supervisor at the other end of the socket FD, and ends everything that
// came of them when the supervisor is gone, see session.hpp. If it is gone because it died, COMMAND
// is started then. The steps between fork and exec are here, in a program of its own, because a
// supervisor written in Python may run no code of its own there (its other threads hold locks at
// the time of the fork).

#include <charconv>
#include <cstdio>
#include <cstring>
#include <string_view>

#include "spawn_guard/command_file.hpp"
#include "spawn_guard/session.hpp"

int main(int argc, char** argv) {
  constexpr int kSocket = 2;
  constexpr int kSeparator = 3;
  constexpr int kCommand = 4;
  int socket = 0;
  const std::string_view text = argc > kSocket ? argv[kSocket] : "";
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), socket);
  const bool is_number = error == std::errc{} && end == text.data() + text.size() && socket > 0;
  const bool has_command = argc > kCommand && std::strcmp(argv[kSeparator], "--") == 0;
  if (!is_number || std::strcmp(argv[1], "--session") != 0 || (argc > kSeparator && !has_command)) {
    std::fprintf(stderr, "usage: spawn_guard --session FD [-- COMMAND ARGS...]\n");
    return play_launch::guard::kRefused;
  }
  return play_launch::guard::guard_session(socket, has_command ? argv + kCommand : nullptr);
}
