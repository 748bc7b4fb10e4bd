#pragma once

#include <sys/types.h>

#include <array>
#include <optional>
#include <string_view>

namespace play_launch::isolation {

/// A thread of a child that was killed, or died, without coming to its end.
struct Grave {
  pid_t thread = 0;
  pid_t process = 0;
  std::array<char, 16> process_name{};
};

/// Remembers such a thread; only the last 4096 are known. Any thread; async-signal-safe, as are the
/// others.
void bury(pid_t thread, pid_t process, std::string_view process_name) noexcept;

/// The id belongs to a living thread again.
void rise(pid_t thread) noexcept;

/// The node of that process, if it is among the dead.
std::optional<Grave> find_grave(pid_t thread) noexcept;

}  // namespace play_launch::isolation
