#pragma once

namespace play_launch {

/// Removes the names in /dev/shm that the middleware (Fast DDS) created in this process and would
/// have removed itself in an orderly end. Only for a process that is about to end: a process that
/// has a segment mapped keeps it, but no other process can find it. Takes no lock of this process.
/// Async-signal-safe.
void unlink_own_segments() noexcept;

}  // namespace play_launch
