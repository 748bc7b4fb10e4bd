#include "topic_recorder/outbox.hpp"

#include <utility>

namespace play_launch::topics {
namespace {

constexpr std::size_t kMostSpare = 32 << 20;

}  // namespace

MemoryFile SpareFiles::take() {
  if (files_.empty()) {
    return {};
  }
  MemoryFile file = std::move(files_.back());
  files_.pop_back();
  size_ -= file.capacity();
  return file;
}

void SpareFiles::give(MemoryFile file) {
  if (size_ + file.capacity() <= kMostSpare) {
    size_ += file.capacity();
    files_.push_back(std::move(file));
  }
}

std::uint64_t& Outbox::size_of(const Entry& entry) {
  return entry.origin == Treatment::held ? held_size_ : live_size_;
}

void Outbox::add(Chunk chunk, Treatment origin) {
  waiting_.push_back({std::move(chunk), origin});
  const Entry& entry = waiting_.back();
  size_of(entry) += entry.chunk.file.capacity();
  send();
}

void Outbox::send() {
  while (link_.flush() && !waiting_.empty()) {
    const Chunk& chunk = waiting_.front().chunk;
    Packet packet(Kind::chunk);
    packet.number(next_slot_)
        .number(chunk.length)
        .number(chunk.chunk_length)
        .number(chunk.records)
        .number(chunk.start_time)
        .number(chunk.end_time)
        .number(static_cast<std::uint32_t>(chunk.parts.size()));
    for (const ChannelPart& part : chunk.parts) {
      packet.number(part.channel).number(part.messages).number(part.index_offset);
    }
    if (!link_.send(packet, chunk.file.descriptor())) {
      return;
    }
    sent_.emplace(next_slot_++, std::move(waiting_.front()));
    waiting_.pop_front();
  }
}

void Outbox::done(std::uint32_t slot) {
  const auto found = sent_.find(slot);
  if (found == sent_.end()) {
    return;
  }
  MemoryFile& file = found->second.chunk.file;
  size_of(found->second) -= file.capacity();
  spare_.give(std::move(file));
  sent_.erase(found);
}

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

void Ring::add(Chunk chunk) {
  const std::uint64_t now = chunk.end_time;
  size_ += chunk.file.capacity();
  chunks_.push_back(std::move(chunk));
  while (!chunks_.empty() && size_ + elsewhere_ > size_limit_) {
    drop_oldest();
  }
  expire(now);
}

void Ring::expire(std::uint64_t now) {
  while (!chunks_.empty() && chunks_.front().end_time + time_ < now) {
    drop_oldest();
  }
}

std::optional<Chunk> Ring::take() {
  if (chunks_.empty()) {
    return std::nullopt;
  }
  Chunk chunk = std::move(chunks_.front());
  chunks_.pop_front();
  size_ -= chunk.file.capacity();
  return chunk;
}

void Ring::drop_oldest() {
  Chunk chunk = std::move(chunks_.front());
  chunks_.pop_front();
  size_ -= chunk.file.capacity();
  spare_.give(std::move(chunk.file));
}

}  // namespace play_launch::topics
