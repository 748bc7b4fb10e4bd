#pragma once

#include <string_view>

namespace play_launch {

/// Writes "component_container: <text>" and a line end to stderr in one piece. For what must be
/// reported when there is no node, or when it may not work any more. Never throws.
void report(std::string_view text) noexcept;

}  // namespace play_launch
