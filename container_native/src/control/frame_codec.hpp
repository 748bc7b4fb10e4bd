#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

namespace play_launch::control {

/// What a frame carries; the payload is the play_launch_msgs message named beside it.
enum class FrameKind : std::uint16_t {
  hello = 1,     // ControlHello, both directions
  load = 2,      // ControlLoad, to the container
  accepted = 3,  // ControlAccepted, from the container
  rejected = 4,  // ControlRejected, from the container
  event = 5,     // ComponentEvent, from the container
  query = 6,     // ControlQuery, to the container
  status = 7,    // ControlStatus, from the container
  cancel = 8,    // ControlCancel, to the container
  unload = 9,    // ControlUnload, to the container
  shutdown = 10  // ControlShutdown, to the container
};

inline constexpr std::uint16_t kProtocolVersion = 1;

/// Bytes of the length field, and of kind and version behind it.
inline constexpr std::size_t kLengthSize = 4;
inline constexpr std::size_t kHeadSize = 4;

/// Largest value of the length field, in bytes.
inline constexpr std::uint32_t kMaxFrameLength = 16U * 1024U * 1024U;

/// The peer sent something that cannot be a frame or a message; the stream has lost its meaning.
class ProtocolError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// One frame as it came in; kind and version are kept as numbers because a newer peer may send
/// ones that this side does not know.
struct Frame {
  std::uint16_t kind = 0;
  std::uint16_t version = 0;
  std::vector<std::uint8_t> payload;
};

/// Bytes of one frame, ready to be sent.
/// Throws ProtocolError when the payload is larger than a frame can carry.
std::vector<std::uint8_t> encode_frame(FrameKind kind, std::span<const std::uint8_t> payload);

/// Cuts a byte stream into frames, whatever the sizes of the pieces in which it arrives.
class FrameDecoder {
 public:
  void feed(std::span<const std::uint8_t> bytes);

  /// The next whole frame, or nothing when more bytes are needed.
  /// Throws ProtocolError on an impossible length; the decoder is of no use afterwards.
  std::optional<Frame> next();

  /// Bytes held that do not make a whole frame yet; not 0 at the end means a cut-off frame.
  std::size_t pending() const { return buffer_.size() - start_; }

 private:
  std::vector<std::uint8_t> buffer_;
  std::size_t start_ = 0;
};

}  // namespace play_launch::control
