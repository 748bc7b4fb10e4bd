#include "topic_recorder/ring.hpp"

#include <utility>

namespace play_launch::topics {

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
