#pragma once

namespace play_launch {

/// Descriptors that belong to the container, which nodes in its descriptor table must not close or
/// replace: its own, its standard streams, and what the middleware had open before the first node.
/// overrides/descriptor_guard.cpp asks before it closes anything. A lock-free table of
/// the lowest 4096 numbers; all of its functions are async-signal-safe and keep errno, unless they
/// say otherwise.

/// Protects `fd` after moving it to a number that is not hit by chance, such as a loop over the
/// low numbers; returns that number, and closes the old one. Where no number is free there, the
/// descriptor stays where it is.
int move_out_of_reach(int fd) noexcept;

/// Protects everything that this process has open, in the place where it is.
void protect_open_descriptors() noexcept;

/// Whether the number is protected and still stands for the file it was protected with. A number
/// that was closed past the guard and used again is protected no more.
bool is_protected(int fd) noexcept;

/// Whether a number from `first` to `last` is.
bool is_any_protected(unsigned first, unsigned last) noexcept;

/// Whether the number may be protected: one look, no system call.
bool may_be_protected(int fd) noexcept;

/// Called before the descriptor is closed or replaced by code that may do so, in a process that
/// shares the container's table of descriptors, or is the container.
void release_protection(int fd) noexcept;

/// Whether this process is the one that protected descriptors.
bool protects_descriptors() noexcept;

}  // namespace play_launch
