#pragma once

#include <sys/types.h>

#include <cstdint>
#include <span>

#include "base/unique_fd.hpp"

namespace play_launch::guard {

/// Has a zygote (main/zygote.hpp) make a process of the command, as a child of ours, and let it
/// begin. Returns its pid, or -errno; then there is none, nor will there be. Waits for at most
/// `kZygotePatience`.
pid_t fork_of_zygote(int zygote, const UniqueFd& command, std::span<const UniqueFd> descriptors,
                     std::span<const std::int32_t> wanted);

}  // namespace play_launch::guard
