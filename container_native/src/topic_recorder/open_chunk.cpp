#include "topic_recorder/open_chunk.hpp"

#include <utility>

namespace play_launch::topics {
namespace {

/// Bytes at which a chunk is complete. One that is larger than this is a single message.
constexpr std::size_t kChunkSize = 1 << 20;

}  // namespace

OpenChunk::Clock::time_point OpenChunk::due() const {
  return is_empty() ? Clock::time_point::max() : began_ + longest_;
}

bool OpenChunk::is_complete() const { return builder_ && builder_->size() > kChunkSize; }

ChunkBuilder& OpenChunk::builder() {
  if (!builder_) {
    builder_.emplace(spare_.take());
  }
  return *builder_;
}

void OpenChunk::append(const MessageHead& head, std::size_t size) {
  if (builder_->is_empty()) {
    began_ = Clock::now();
  }
  builder_->append(head, size);
}

std::optional<Chunk> OpenChunk::finish() {
  if (is_empty()) {
    return std::nullopt;
  }
  Chunk chunk = std::move(*builder_).finish();
  builder_.reset();
  return chunk;
}

}  // namespace play_launch::topics
