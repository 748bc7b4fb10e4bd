#pragma once

namespace play_launch::container {

/// Exit statuses of the container (sysexits.h where it has one).
inline constexpr int kExitOk = 0;
inline constexpr int kExitFailed = 1;
inline constexpr int kExitUsage = 64;
inline constexpr int kExitProtocol = 70;
/// A node shut down the ROS context that it shares with the others.
inline constexpr int kExitContext = 79;

}  // namespace play_launch::container
