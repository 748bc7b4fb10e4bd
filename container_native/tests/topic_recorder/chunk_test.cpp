// Chunks: their bytes, their checksums, and how many of them are held.

#include "topic_recorder/chunk.hpp"

#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include "check.hpp"
#include "topic_recorder/crc32.hpp"
#include "topic_recorder/outbox.hpp"
#include "topic_recorder/ring.hpp"

using namespace play_launch::topics;

namespace {

std::uint32_t checksum(std::string_view text) {
  return crc32({reinterpret_cast<const std::byte*>(text.data()), text.size()});
}

void test_checksum() {
  CHECK(checksum("") == 0);
  CHECK(checksum("123456789") == 0xCBF43926);
  CHECK(checksum("The quick brown fox jumps over the lazy dog") == 0x414FA339);
}

void put(ChunkBuilder& builder, std::uint16_t channel, std::uint64_t time, std::string_view data) {
  std::byte* const place = builder.room_for(data.size());
  CHECK(place != nullptr && builder.room() >= data.size());
  std::memcpy(place, data.data(), data.size());
  builder.append({channel, 7, time, time - 1}, data.size());
}

template <class Number>
Number number_at(const Chunk& chunk, std::size_t at) {
  Number value{};
  std::memcpy(&value, chunk.file.data() + at, sizeof value);
  return value;
}

void test_bytes_of_a_chunk() {
  ChunkBuilder builder{MemoryFile()};
  CHECK(builder.is_empty());
  put(builder, 2, 300, "abc");
  put(builder, 1, 200, "");
  put(builder, 2, 250, "defgh");
  CHECK(!builder.is_empty());
  const Chunk chunk = std::move(builder).finish();
  // A message record is 9 + 22 bytes and its data.
  CHECK(chunk.records == 3 * 31 + 8);
  CHECK(chunk.chunk_length == 9 + 40 + chunk.records);
  CHECK(chunk.start_time == 200 && chunk.end_time == 300);
  CHECK(number_at<std::uint8_t>(chunk, 0) == 6);
  CHECK(number_at<std::uint64_t>(chunk, 1) == chunk.chunk_length - 9);
  CHECK(number_at<std::uint64_t>(chunk, 9) == 200 && number_at<std::uint64_t>(chunk, 17) == 300);
  CHECK(number_at<std::uint64_t>(chunk, 25) == chunk.records);
  CHECK(number_at<std::uint32_t>(chunk, 33) == crc32({chunk.file.data() + 49, chunk.records}));
  CHECK(number_at<std::uint32_t>(chunk, 37) == 0);
  CHECK(number_at<std::uint64_t>(chunk, 41) == chunk.records);
  CHECK(chunk.parts.size() == 2);
  CHECK(chunk.parts[0].channel == 1 && chunk.parts[0].messages == 1);
  CHECK(chunk.parts[1].channel == 2 && chunk.parts[1].messages == 2);
  CHECK(chunk.parts[0].index_offset == chunk.chunk_length);
  const std::size_t second = chunk.parts[1].index_offset;
  CHECK(number_at<std::uint8_t>(chunk, second) == 7);
  CHECK(number_at<std::uint64_t>(chunk, second + 1) == 6 + 2 * 16);
  CHECK(number_at<std::uint16_t>(chunk, second + 9) == 2);
  CHECK(number_at<std::uint32_t>(chunk, second + 11) == 2 * 16);
  CHECK(number_at<std::uint64_t>(chunk, second + 15) == 300);
  CHECK(number_at<std::uint64_t>(chunk, second + 23) == 0);
  CHECK(number_at<std::uint64_t>(chunk, second + 31) == 250);
  CHECK(number_at<std::uint64_t>(chunk, second + 39) == 2 * 31 + 3);
  CHECK(chunk.length == second + 15 + 2 * 16);
}

void test_a_chunk_grows() {
  ChunkBuilder builder{MemoryFile()};
  const std::string large(3'000'000, 'x');
  put(builder, 1, 1, "first");
  put(builder, 1, 2, large);
  const Chunk chunk = std::move(builder).finish();
  CHECK(std::memcmp(chunk.file.data() + 49 + 31, "first", 5) == 0);
  CHECK(std::memcmp(chunk.file.data() + 49 + 31 + 5 + 31, large.data(), large.size()) == 0);
}

Chunk chunk_of(std::uint64_t time, std::size_t size) {
  ChunkBuilder builder{MemoryFile()};
  put(builder, 1, time, std::string(size, 'x'));
  return std::move(builder).finish();
}

std::vector<std::uint64_t> times(Ring& ring) {
  std::vector<std::uint64_t> found;
  while (const auto chunk = ring.take()) {
    found.push_back(chunk->end_time);
  }
  return found;
}

void test_what_is_old_is_let_go() {
  SpareFiles spare;
  Ring ring(spare, 100, 1 << 30);
  for (const std::uint64_t time : {1000, 1050, 1100, 1101}) {
    ring.add(chunk_of(time, 10));
  }
  CHECK((times(ring) == std::vector<std::uint64_t>{1050, 1100, 1101}));
  CHECK(ring.is_empty());
  ring.add(chunk_of(2000, 10));
  ring.expire(2100);
  CHECK(!ring.is_empty());
  ring.expire(2101);
  CHECK(ring.is_empty());
}

void test_what_is_too_much_is_let_go() {
  SpareFiles spare;
  Ring ring(spare, 1000, 4'000'000);
  for (std::uint64_t time = 1; time <= 5; ++time) {
    ring.add(chunk_of(time, 900'000));
  }
  const auto kept = times(ring);
  CHECK(kept.size() >= 2 && kept.size() <= 4 && kept.back() == 5);
  ring.set_elsewhere(4'000'000);
  ring.add(chunk_of(6, 900'000));
  CHECK(ring.is_empty());
}

}  // namespace

int main() {
  test_checksum();
  test_bytes_of_a_chunk();
  test_a_chunk_grows();
  test_what_is_old_is_let_go();
  test_what_is_too_much_is_let_go();
}
