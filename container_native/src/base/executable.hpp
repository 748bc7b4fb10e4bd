#pragma once

#include <sys/types.h>

#include <optional>
#include <string>

namespace play_launch {

/// The path of the program that a process runs, if it is another one than this process's; nothing
/// when it is the same, or cannot be known.
std::optional<std::string> other_program_of(pid_t pid);

}  // namespace play_launch
