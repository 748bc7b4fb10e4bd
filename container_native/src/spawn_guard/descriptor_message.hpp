#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/unique_fd.hpp"

namespace play_launch {

/// What a SOCK_SEQPACKET carries in one piece: native-endian 32-bit integers, and descriptors.
struct DescriptorMessage {
  static constexpr std::size_t kMostDescriptors = 20;
  static constexpr std::size_t kMostNumbers = kMostDescriptors + 4;

  std::vector<std::int32_t> numbers;
  std::vector<UniqueFd> descriptors;

  /// False at the end of the socket, and when nothing can be received.
  bool receive(int socket);
};

}  // namespace play_launch
