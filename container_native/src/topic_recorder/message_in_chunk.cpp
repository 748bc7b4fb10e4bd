#include "topic_recorder/message_in_chunk.hpp"

#include <cstddef>
#include <cstdint>

namespace play_launch::topics {
namespace {

/// Half of what readers of a recording take for damage.
constexpr std::size_t kLargestMessage = 512 << 20;

void* no_memory(std::size_t, void*) { return nullptr; }
void* no_zeroed_memory(std::size_t, std::size_t, void*) { return nullptr; }
void keep(void*, void*) {}
void* grow(void*, std::size_t size, void* state) {
  if (size > kLargestMessage) {
    return nullptr;
  }
  return static_cast<ChunkBuilder*>(state)->room_for(size);
}

}  // namespace

rmw_serialized_message_t message_in(ChunkBuilder& chunk) {
  rmw_serialized_message_t message = rmw_get_zero_initialized_serialized_message();
  message.buffer = reinterpret_cast<std::uint8_t*>(chunk.room_for(0));
  message.buffer_capacity = chunk.room();
  message.allocator = {no_memory, keep, grow, no_zeroed_memory, &chunk};
  return message;
}

}  // namespace play_launch::topics
