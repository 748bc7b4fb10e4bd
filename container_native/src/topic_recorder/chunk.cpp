#include "topic_recorder/chunk.hpp"

#include <algorithm>
#include <bit>
#include <cstring>

#include "topic_recorder/crc32.hpp"

namespace play_launch::topics {
namespace {

static_assert(std::endian::native == std::endian::little, "MCAP is little-endian");

constexpr std::uint8_t kMessage = 0x05;
constexpr std::uint8_t kChunk = 0x06;
constexpr std::uint8_t kMessageIndex = 0x07;
/// Kind and length of a record.
constexpr std::size_t kRecordHead = 1 + 8;
/// Channel, sequence, log time, publish time.
constexpr std::size_t kMessageHead = 2 + 4 + 8 + 8;
/// Start, end, size of the records, their checksum, length of the compression's name (none), length
/// of the records.
constexpr std::size_t kChunkHead = 8 + 8 + 8 + 4 + 4 + 8;
/// Channel, size of the entries in bytes.
constexpr std::size_t kIndexHead = 2 + 4;
constexpr std::size_t kIndexEntry = 8 + 8;

constexpr std::size_t kFirstRecord = kRecordHead + kChunkHead;

class Cursor {
 public:
  explicit Cursor(std::byte* at) : at_(at) {}

  template <class Number>
  void put(Number value) {
    std::memcpy(at_, &value, sizeof value);
    at_ += sizeof value;
  }

 private:
  std::byte* at_;
};

}  // namespace

ChunkBuilder::ChunkBuilder(MemoryFile file) : file_(std::move(file)), size_(kFirstRecord) {}

std::byte* ChunkBuilder::room_for(std::size_t data_size) {
  const std::size_t begin = size_ + kRecordHead + kMessageHead;
  return file_.reserve(begin + data_size) ? file_.data() + begin : nullptr;
}

std::size_t ChunkBuilder::room() const {
  const std::size_t begin = size_ + kRecordHead + kMessageHead;
  return file_.capacity() > begin ? file_.capacity() - begin : 0;
}

void ChunkBuilder::append(const MessageHead& head, std::size_t data_size) {
  Cursor cursor(file_.data() + size_);
  cursor.put(kMessage);
  cursor.put(std::uint64_t{kMessageHead + data_size});
  cursor.put(head.channel);
  cursor.put(head.sequence);
  cursor.put(head.log_time);
  cursor.put(head.publish_time);
  start_time_ = is_empty() ? head.log_time : std::min(start_time_, head.log_time);
  end_time_ = std::max(end_time_, head.log_time);
  indexes_[head.channel].emplace_back(head.log_time, size_ - kFirstRecord);
  size_ += kRecordHead + kMessageHead + data_size;
}

Chunk ChunkBuilder::finish() && {
  Chunk chunk;
  chunk.chunk_length = size_;
  chunk.records = size_ - kFirstRecord;
  chunk.start_time = start_time_;
  chunk.end_time = end_time_;
  chunk.length = size_;
  for (const auto& [channel, entries] : indexes_) {
    chunk.length += kRecordHead + kIndexHead + entries.size() * kIndexEntry;
  }
  if (!file_.reserve(chunk.length)) {
    return chunk;
  }
  Cursor head(file_.data());
  head.put(kChunk);
  head.put(std::uint64_t{size_ - kRecordHead});
  head.put(start_time_);
  head.put(end_time_);
  head.put(chunk.records);
  head.put(crc32({file_.data() + kFirstRecord, chunk.records}));
  head.put(std::uint32_t{0});
  head.put(chunk.records);
  std::size_t at = size_;
  for (const auto& [channel, entries] : indexes_) {
    chunk.parts.push_back({channel, static_cast<std::uint32_t>(entries.size()), at});
    const std::size_t content = kIndexHead + entries.size() * kIndexEntry;
    Cursor index(file_.data() + at);
    index.put(kMessageIndex);
    index.put(std::uint64_t{content});
    index.put(channel);
    index.put(static_cast<std::uint32_t>(entries.size() * kIndexEntry));
    for (const auto& [time, place] : entries) {
      index.put(time);
      index.put(place);
    }
    at += kRecordHead + content;
  }
  chunk.file = std::move(file_);
  return chunk;
}

}  // namespace play_launch::topics
