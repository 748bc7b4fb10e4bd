#pragma once

#include <chrono>
#include <cstdint>

namespace play_launch::isolation {

/// The calling thread's mask of blocked signals in the kernel's format, one bit a signal; replaced
/// by `mask`. Past the C library, which never blocks the signals that it keeps for itself.
/// Async-signal-safe, as are the others.
std::uint64_t exchange_signal_mask(std::uint64_t mask) noexcept;

/// Sets the calling thread's mask of blocked signals to all of them (including those that the C
/// library keeps for itself) or none.
void block_all_signals() noexcept;
void unblock_all_signals() noexcept;

/// In a child: a signal to it after so long; for a handler, si_code is SI_TIMER then, and si_ptr
/// the cookie. False with errno when there is no timer to be had. Async-signal-safe.
bool signal_self_after(std::chrono::milliseconds limit, int signal,
                       void* cookie = nullptr) noexcept;

/// In a child: ends it by that signal's default action.
[[noreturn]] void die_of(int signal) noexcept;

}  // namespace play_launch::isolation
