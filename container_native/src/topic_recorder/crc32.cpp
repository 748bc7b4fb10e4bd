#include "topic_recorder/crc32.hpp"

#include <array>
#include <bit>
#include <cstring>

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

}  // namespace

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

}  // namespace play_launch::topics
