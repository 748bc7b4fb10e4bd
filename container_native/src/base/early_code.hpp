#pragma once

namespace play_launch {

/// Remembers which code is loaded: the middleware and what it needs, without the program and the
/// libraries that call code of nodes. Once, in the
/// container, before the first library of a node is loaded. Takes the loader's lock.
void note_early_code() noexcept;

/// Whether the address is in that code; always false before. Async-signal-safe.
bool is_early_code(const void* address) noexcept;

}  // namespace play_launch
