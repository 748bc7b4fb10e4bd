#pragma once

#include <sys/types.h>

namespace play_launch::guard {

constexpr int kRefused = 125;    // wrong usage, or the parent is gone
constexpr int kCannotRun = 126;  // the command is there, but cannot be executed
constexpr int kNotFound = 127;   // the command is not there

/// Has the kernel kill this process when `parent` ends; false where it has ended already.
bool tie_to(pid_t parent, const char* command);

/// Makes `folder` the working directory, if it is not null; false, with a message, if it cannot.
bool enter(const char* folder);

/// Becomes the command, looked up in PATH; returns the exit status that tells why it could not.
int become(char* const* argv);

}  // namespace play_launch::guard
