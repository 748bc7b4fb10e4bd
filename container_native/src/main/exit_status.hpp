#pragma once

namespace play_launch::container {

/// Exit statuses of the container (sysexits.h where it has one).
inline constexpr int kExitOk = 0;
inline constexpr int kExitFailed = 1;
inline constexpr int kExitUsage = 64;
inline constexpr int kExitProtocol = 70;

}  // namespace play_launch::container
