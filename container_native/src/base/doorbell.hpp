#pragma once

#include "base/unique_fd.hpp"

namespace play_launch {

/// An eventfd to wake a thread with, at a high number. Throws std::system_error.
UniqueFd make_doorbell();

/// Wakes the threads that poll it. Any thread of any process that has it, also a signal handler.
void ring(int doorbell) noexcept;

/// Forgets what was rung.
void hush(int doorbell) noexcept;

}  // namespace play_launch
