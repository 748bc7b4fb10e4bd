#pragma once

#include <sys/types.h>

#include <cstdint>
#include <span>

#include "base/unique_fd.hpp"

namespace play_launch::guard {

/// A child of ours that waits at the end of its line until it may begin; it ends when that closes.
struct Fork {
  pid_t pid;  // -errno: it was not and will not be started
  UniqueFd line;
};

/// Has a zygote (main/zygote.hpp) make a process of the command. Waits for at most
/// `kZygotePatience`.
Fork fork_of_zygote(int zygote, const UniqueFd& command, std::span<const UniqueFd> descriptors,
                    std::span<const std::int32_t> wanted);

void let_begin(const Fork& fork);

}  // namespace play_launch::guard
