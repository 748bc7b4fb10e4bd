#pragma once

#include <rmw/serialized_message.h>

#include "topic_recorder/chunk.hpp"

namespace play_launch::topics {

/// A message for the middleware to write into, at the place of the next one in the chunk. The chunk
/// grows where the message is larger than its room; it must outlive the message.
rmw_serialized_message_t message_in(ChunkBuilder& chunk);

}  // namespace play_launch::topics
