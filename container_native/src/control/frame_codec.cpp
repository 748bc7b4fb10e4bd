#include "control/frame_codec.hpp"

namespace play_launch::control {
namespace {

void put_le(std::vector<std::uint8_t>& out, std::uint32_t value, std::size_t bytes) {
  for (std::size_t i = 0; i < bytes; ++i) {
    out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
  }
}

std::uint32_t get_le(const std::uint8_t* in, std::size_t bytes) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < bytes; ++i) {
    value |= static_cast<std::uint32_t>(in[i]) << (8 * i);
  }
  return value;
}

}  // namespace

std::vector<std::uint8_t> encode_frame(FrameKind kind, std::span<const std::uint8_t> payload) {
  if (payload.size() > kMaxFrameLength - kHeadSize) {
    throw ProtocolError("a message of " + std::to_string(payload.size()) +
                        " bytes does not fit into a frame (limit " +
                        std::to_string(kMaxFrameLength) + ")");
  }
  std::vector<std::uint8_t> out;
  out.reserve(kLengthSize + kHeadSize + payload.size());
  put_le(out, static_cast<std::uint32_t>(kHeadSize + payload.size()), 4);
  put_le(out, static_cast<std::uint16_t>(kind), 2);
  put_le(out, kProtocolVersion, 2);
  out.insert(out.end(), payload.begin(), payload.end());
  return out;
}

void FrameDecoder::feed(std::span<const std::uint8_t> bytes) {
  // What was handed out already goes only now, so that next() never moves memory.
  buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(start_));
  start_ = 0;
  buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
}

std::optional<Frame> FrameDecoder::next() {
  if (pending() < kLengthSize) {
    return std::nullopt;
  }
  const std::uint8_t* head = buffer_.data() + start_;
  const std::uint32_t length = get_le(head, 4);
  if (length < kHeadSize || length > kMaxFrameLength) {
    throw ProtocolError("frame length " + std::to_string(length) + " is outside of " +
                        std::to_string(kHeadSize) + " to " + std::to_string(kMaxFrameLength));
  }
  if (pending() < kLengthSize + length) {
    return std::nullopt;
  }
  Frame frame;
  frame.kind = static_cast<std::uint16_t>(get_le(head + 4, 2));
  frame.version = static_cast<std::uint16_t>(get_le(head + 6, 2));
  const std::uint8_t* payload = head + kLengthSize + kHeadSize;
  frame.payload.assign(payload, payload + (length - kHeadSize));
  start_ += kLengthSize + length;
  return frame;
}

}  // namespace play_launch::control
