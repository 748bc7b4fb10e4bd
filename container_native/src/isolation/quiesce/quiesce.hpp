#pragma once

#include <cstddef>
#include <cstdint>

#include "isolation/record/child_record.hpp"

namespace play_launch::isolation {

/// In a child whose end has been decided, in the thread that ends it: cancels the program and
/// brings every other thread to a place where its death takes no lock along, within
/// ChildOptions::quiesce_limit. A thread may exit, come to park_if_dying(), or is
/// interrupted: when its innermost frames are neither in the middleware, nor in the allocator, the
/// loader or stdio, it is parked there, else continued until it comes out. Writes the counts
/// into the slot. Async-signal-safe.
void quiesce(ChildRecord& child) noexcept;

/// In a child: installs the handler of the signal that quiesce() interrupts threads with.
void install_park_handler() noexcept;

/// Stops the calling thread of the child for good and counts it as parked. `at_rest`: it is not
/// amidst anything that it shares with others. Async-signal-safe.
[[noreturn]] void park(ChildRecord& child, bool at_rest = true) noexcept;

/// In a child that is dying (a fault, exit(), an ignored request to leave), stops the calling
/// thread for good, and counts it as harmless; elsewhere, returns at once. For the place behind
/// spin(): the node must not be taken apart while one of its callbacks lies crashed.
void park_if_dying() noexcept;

}  // namespace play_launch::isolation
