#pragma once

#include <chrono>

namespace play_launch {

/// When the supervisor is gone, so long may those of its processes run on that leave by themselves;
/// then spawn_guard kills them. Nothing of a session may live 1 s later. A killed process leaves
/// its shared memory behind, so one that leaves in order has to be gone before.
constexpr std::chrono::milliseconds kOrphanGrace{700};

}  // namespace play_launch
