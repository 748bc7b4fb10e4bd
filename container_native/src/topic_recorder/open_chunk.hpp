#pragma once

#include <chrono>
#include <cstddef>
#include <optional>

#include "topic_recorder/chunk.hpp"
#include "topic_recorder/outbox.hpp"
#include "topic_recorder/selection.hpp"

namespace play_launch::topics {

/// The chunk that messages of one treatment are written into, until it is large or old enough.
class OpenChunk {
 public:
  using Clock = std::chrono::steady_clock;

  /// `longest` is how long a message may wait for the end of its chunk.
  OpenChunk(Treatment treatment, Clock::duration longest, SpareFiles& spare)
      : treatment_(treatment), longest_(longest), spare_(spare) {}

  [[nodiscard]] Treatment treatment() const { return treatment_; }
  [[nodiscard]] bool is_empty() const { return !builder_ || builder_->is_empty(); }
  /// When it has to be finished; never if it is empty.
  [[nodiscard]] Clock::time_point due() const;
  [[nodiscard]] bool is_complete() const;

  /// Where the bytes of the next message belong, before it is appended.
  ChunkBuilder& builder();
  /// Appends the message whose `size` bytes the builder has got.
  void append(const MessageHead& head, std::size_t size);
  /// Without data when memory was short. None if it was empty.
  std::optional<Chunk> finish();

 private:
  const Treatment treatment_;
  const Clock::duration longest_;
  SpareFiles& spare_;
  std::optional<ChunkBuilder> builder_;
  /// When its first message came.
  Clock::time_point began_{};
};

}  // namespace play_launch::topics
