#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "isolation/record/crash_slot.hpp"

namespace play_launch::isolation {

/// throw_site.cpp defines __cxa_throw() for the whole program, as exit_guard.cpp does with exit():
/// in a child, every throw notes the call stack it comes from. An exception that is caught and
/// thrown on, as executors do, has lost that when it ends the child.

/// Finds the C++ library's own function. Once, before the first child.
void prepare_throw_sites() noexcept;

/// Copies the call stack of the calling thread's last throw to `frames`, innermost first, if it was
/// of that exception object; returns how many. 0: not known.
std::uint32_t throw_site(const void* exception,
                         std::array<std::uintptr_t, CrashReport::kMaxFrames>& frames) noexcept;

}  // namespace play_launch::isolation
