#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <play_launch_msgs/msg/node_parameters.hpp>

#include "topic_recorder/chunk.hpp"

namespace play_launch::topics {

/// Puts what a node answered into a chunk, to be appended there; returns its size in bytes, or
/// nothing when it cannot be serialised. `now` is in nanoseconds since the epoch.
std::optional<std::size_t> put(play_launch_msgs::msg::NodeParameters parameters, std::uint64_t now,
                               ChunkBuilder& chunk);

}  // namespace play_launch::topics
