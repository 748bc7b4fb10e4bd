#pragma once

#include "base/command_file.hpp"

namespace play_launch::container {

/// Whether show_command() works here: the kernel was built with CONFIG_CHECKPOINT_RESTORE, and
/// nothing forbids it.
bool can_show_commands();

/// Has /proc/self/cmdline and /proc/self/environ, and so ps and top, show the command, which must
/// stay where it is. False when the kernel refuses.
bool show_command(const Command& command);

}  // namespace play_launch::container
