#pragma once

namespace play_launch::container {

/// Removes the names in /dev/shm that the middleware (Fast DDS) created in this process and would
/// have removed itself in an orderly end. Only for a process that is about to end: whoever has a
/// segment mapped keeps it, but nobody can find it any more. Takes no lock of this process.
/// Async-signal-safe.
void unlink_own_segments() noexcept;

/// Opens the libraries in which the middleware, if it is Fast DDS, is going to look for the types
/// that a container has of its own. Initialises nothing of it. Takes the dynamic loader's lock.
void open_type_supports();

}  // namespace play_launch::container
