#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "topic_recorder/chunk.hpp"
#include "topic_recorder/outbox.hpp"

namespace play_launch::topics {

/// The last seconds of the topics that are held, in chunks that are ready to be passed on.
class Ring {
 public:
  Ring(SpareFiles& spare, std::int64_t time, std::uint64_t size)
      : spare_(spare), time_(static_cast<std::uint64_t>(time)), size_limit_(size) {}

  /// Takes a chunk, and drops what is too old or too much beside it.
  void add(Chunk chunk);
  /// Drops what is older than it may be at `now`, in nanoseconds since the epoch.
  void expire(std::uint64_t now);
  /// Gives the oldest chunk away.
  std::optional<Chunk> take();
  /// Bytes that others hold of what it once held; there is that much less room here.
  void set_elsewhere(std::uint64_t size) { elsewhere_ = size; }

  [[nodiscard]] bool is_empty() const { return chunks_.empty(); }

 private:
  void drop_oldest();

  SpareFiles& spare_;
  const std::uint64_t time_;
  const std::uint64_t size_limit_;
  std::uint64_t size_ = 0;
  std::uint64_t elsewhere_ = 0;
  std::deque<Chunk> chunks_;
};

}  // namespace play_launch::topics
