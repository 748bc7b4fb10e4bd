#pragma once

#include <cstdint>
#include <deque>
#include <map>
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

}  // namespace play_launch::topics
