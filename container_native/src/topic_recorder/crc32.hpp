#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace play_launch::topics {

/// The checksum of zlib's crc32() and of MCAP.
std::uint32_t crc32(std::span<const std::byte> data);

}  // namespace play_launch::topics
