#pragma once

#include <rmw/serialized_message.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "base/unique_fd.hpp"

namespace play_launch::topics {

/// A file in memory (memfd), mapped, that grows. Its descriptor can be handed to another process.
class MemoryFile {
 public:
  /// Throws std::system_error.
  MemoryFile();
  [[nodiscard]] int descriptor() const { return file_.get(); }
  /// Moves when it grows.
  [[nodiscard]] std::byte* data() const { return data_.get(); }
  [[nodiscard]] std::size_t capacity() const { return data_ ? data_.get_deleter().size : 0; }

  /// Makes room for at least so many bytes; false when there is no memory.
  bool reserve(std::size_t size);

 private:
  struct Unmap {
    std::size_t size;
    void operator()(std::byte* data) const;
  };

  UniqueFd file_;
  std::unique_ptr<std::byte, Unmap> data_;
};

/// What MCAP wants to know of a message beside its data; times in nanoseconds since the epoch.
struct MessageHead {
  std::uint16_t channel = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time = 0;
  std::uint64_t publish_time = 0;
};

/// Messages of one channel in a chunk.
struct ChannelPart {
  std::uint16_t channel = 0;
  std::uint32_t messages = 0;
  /// Where its message index begins in the file.
  std::uint64_t index_offset = 0;
};

/// A chunk record and the message indexes that follow it, as they stand in an MCAP file.
struct Chunk {
  MemoryFile file;
  /// Bytes of all of it, and of the chunk record with its head.
  std::uint64_t length = 0;
  std::uint64_t chunk_length = 0;
  /// Bytes of the records in it, which are not compressed.
  std::uint64_t records = 0;
  std::uint64_t start_time = 0;
  std::uint64_t end_time = 0;
  std::vector<ChannelPart> parts;
};

/// Makes a chunk in a file in memory, see https://mcap.dev/spec. The data of a message is put where
/// it belongs by its owner, so that it is not copied again.
class ChunkBuilder {
 public:
  explicit ChunkBuilder(MemoryFile file);

  [[nodiscard]] bool is_empty() const { return indexes_.empty(); }
  /// Bytes of the chunk record so far.
  [[nodiscard]] std::size_t size() const { return size_; }

  /// Where the data of the next message goes, with room for at least so many bytes; what is there
  /// already is kept. Null when there is no memory.
  std::byte* room_for(std::size_t data_size);
  /// How many bytes fit there.
  [[nodiscard]] std::size_t room() const;
  /// Takes up the message whose data is there.
  void append(const MessageHead& head, std::size_t data_size);

  /// Null data in its file when there is no memory for the indexes.
  Chunk finish() &&;

 private:
  MemoryFile file_;
  std::size_t size_;
  std::uint64_t start_time_ = 0;
  std::uint64_t end_time_ = 0;
  /// For each channel, time and place of each message.
  std::map<std::uint16_t, std::vector<std::pair<std::uint64_t, std::uint64_t>>> indexes_;
};

/// A message for the middleware to write into, at the place of the next one in the chunk. The chunk
/// grows where the message is larger than its room; it must outlive the message.
rmw_serialized_message_t message_in(ChunkBuilder& chunk);

}  // namespace play_launch::topics
