#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <vector>

#include "topic_recorder/chunk.hpp"
#include "topic_recorder/selection.hpp"
#include "topic_recorder/supervisor_link.hpp"

namespace play_launch::topics {

/// Files in memory that wait to be used again: their pages need not be cleared once more.
class SpareFiles {
 public:
  MemoryFile take();
  void give(MemoryFile file);

 private:
  std::vector<MemoryFile> files_;
  std::size_t size_ = 0;
};

/// Chunks on their way to the file: those that wait to be sent, and those that the supervisor has
/// not written yet. Bounded, so a disk or a supervisor that does not go on cannot make us grow.
class Outbox {
 public:
  Outbox(SupervisorLink& link, SpareFiles& spare) : link_(link), spare_(spare) {}

  /// Whether another chunk of messages as they come may be made.
  [[nodiscard]] bool has_room() const { return live_size_ < kMostLive; }
  /// Bytes of memory that chunks of the ring take here.
  [[nodiscard]] std::uint64_t held_size() const { return held_size_; }
  /// Whether everything was written.
  [[nodiscard]] bool is_empty() const { return waiting_.empty() && sent_.empty(); }
  [[nodiscard]] bool is_waiting_to_send() const { return !waiting_.empty() || link_.is_waiting(); }

  void add(Chunk chunk, Treatment origin);
  /// Sends what the socket takes.
  void send();
  /// The supervisor is done with it.
  void done(std::uint32_t slot);

 private:
  struct Entry {
    Chunk chunk;
    Treatment origin;
  };

  static constexpr std::uint64_t kMostLive = 64 << 20;

  std::uint64_t& size_of(const Entry& entry);

  SupervisorLink& link_;
  SpareFiles& spare_;
  std::deque<Entry> waiting_;
  std::map<std::uint32_t, Entry> sent_;
  std::uint32_t next_slot_ = 1;
  std::uint64_t live_size_ = 0;
  std::uint64_t held_size_ = 0;
};

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
