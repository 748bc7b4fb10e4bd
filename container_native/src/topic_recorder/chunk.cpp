#include "topic_recorder/chunk.hpp"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <system_error>
#include <utility>

namespace play_launch::topics {
namespace {

constexpr std::uint32_t kPolynomial = 0xEDB88320;
constexpr std::size_t kStride = 16;
using Tables = std::array<std::array<std::uint32_t, 256>, kStride>;

/// "Slicing": sixteen bytes at a time, each with a table of its own. Table k has what a byte does
/// to the sum when k more bytes follow it.
constexpr Tables make_tables() {
  Tables tables{};
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    std::uint32_t sum = byte;
    for (int bit = 0; bit < 8; ++bit) {
      sum = (sum >> 1) ^ ((sum & 1) != 0 ? kPolynomial : 0);
    }
    tables[0][byte] = sum;
  }
  for (std::size_t k = 1; k < kStride; ++k) {
    for (std::size_t byte = 0; byte < 256; ++byte) {
      const std::uint32_t before = tables[k - 1][byte];
      tables[k][byte] = (before >> 8) ^ tables[0][before & 0xFF];
    }
  }
  return tables;
}

constexpr Tables kTables = make_tables();

std::uint32_t word(const std::byte* at) {
  static_assert(std::endian::native == std::endian::little);
  std::uint32_t value = 0;
  std::memcpy(&value, at, sizeof value);
  return value;
}

std::uint32_t slice(std::uint32_t value, std::size_t table) {
  return kTables[table][value & 0xFF] ^ kTables[table - 1][(value >> 8) & 0xFF] ^
         kTables[table - 2][(value >> 16) & 0xFF] ^ kTables[table - 3][value >> 24];
}

/// The checksum of zlib's crc32() and of MCAP.
std::uint32_t crc32(std::span<const std::byte> data) {
  std::uint32_t sum = 0xFFFFFFFF;
  while (data.size() >= kStride) {
    sum = slice(word(data.data()) ^ sum, 15) ^ slice(word(data.data() + 4), 11) ^
          slice(word(data.data() + 8), 7) ^ slice(word(data.data() + 12), 3);
    data = data.subspan(kStride);
  }
  for (const std::byte byte : data) {
    sum = (sum >> 8) ^ kTables[0][(sum ^ static_cast<std::uint32_t>(byte)) & 0xFF];
  }
  return ~sum;
}

/// What a file grows by.
constexpr std::size_t kStep = 256 << 10;

}  // namespace

MemoryFile::MemoryFile() : file_(::memfd_create("topics", MFD_CLOEXEC)) {
  if (!file_) {
    throw std::system_error(errno, std::generic_category(), "no file in memory");
  }
}

void MemoryFile::Unmap::operator()(std::byte* data) const { ::munmap(data, size); }

bool MemoryFile::reserve(std::size_t size) {
  if (size <= capacity()) {
    return true;
  }
  const std::size_t wanted = (size + kStep - 1) / kStep * kStep;
  if (::ftruncate(file_.get(), static_cast<off_t>(wanted)) != 0) {
    return false;
  }
  void* const place =
      data_ ? ::mremap(data_.get(), capacity(), wanted, MREMAP_MAYMOVE)
            : ::mmap(nullptr, wanted, PROT_READ | PROT_WRITE, MAP_SHARED, file_.get(), 0);
  if (place == MAP_FAILED) {
    return false;
  }
  static_cast<void>(data_.release());
  data_ = {static_cast<std::byte*>(place), Unmap{wanted}};
  return true;
}

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
