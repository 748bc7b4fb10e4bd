#pragma once

namespace play_launch {

/// Remembers which libraries are loaded: the client library, the middleware, the allocator and what
/// they need. What comes later belongs to nodes. Once, in the container, before the first library
/// of a node is loaded. Takes the loader's lock.
void note_early_code() noexcept;

/// Whether the address is code of such a library; the program does not count. Always false before.
/// Async-signal-safe.
bool is_early_code(const void* address) noexcept;

}  // namespace play_launch
