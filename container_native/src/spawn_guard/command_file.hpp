#pragma once

#include <sys/types.h>

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "base/unique_fd.hpp"

namespace play_launch {

/// A command with its environment: four 32-bit counts, then the arguments, then NAME=VALUE, then
/// the working directory if there is one to enter, then settings of the process (see
/// ResourceSetting), each with a NUL at its end. Pointers into the text, each list with a null at
/// its end.
struct Command {
  std::string text;
  std::vector<char*> argv;
  std::vector<char*> environment;
  std::vector<char*> folder;
  std::vector<char*> settings;

  /// False when the file does not hold a command.
  bool read(int file);
  /// Applies the settings to the calling process, as far as the kernel agrees: the supervisor that
  /// sent them checks what is in force. False when one is malformed, or required and refused.
  bool apply_settings() const;
};

/// Gives the received descriptors the numbers that the command knows; false with errno set. Every
/// other descriptor from 3 on is closed by the next exec.
bool place_descriptors(std::span<const UniqueFd> received, std::span<const std::int32_t> wanted);

}  // namespace play_launch

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
