#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <deque>
#include <functional>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "base/unique_fd.hpp"

namespace play_launch::topics {

/// Packets of the socket to the supervisor, a SOCK_SEQPACKET: a 32-bit kind, then its fields.
/// Little-endian; a text has its length before it, in 32 bits. `recording/topic_recorder/link.py`
/// is the other end.
///
/// To the supervisor:
///   channel  request u32, topic, type, offered_qos_profiles: wants a channel
///   chunk    slot u32, length u64, chunk_length u64, records u64, start_time u64, end_time u64,
///            number of parts u32, each channel u16, messages u32, index_offset u64; with the file
///   drops    topic, messages over the budget u64, messages without room u64: since the last one
///   warning  text
///   snapshot number u32, messages u64, bytes u64, nanoseconds that they span u64: it was handed
///            over
///   measured topic, types, publishers u32, reliable ones u32, latched ones u32, messages u64,
///            largest nanoseconds between two of them or since the last u64, nanoseconds u64: since
///            the last one
/// From the supervisor:
///   answer   request u32, channel u16, or 0 without one
///   done     slot u32: its file is not needed any more
///   take     number u32: pass on what is held
///   stop     pass on what is there and end
enum class Kind : std::uint32_t {
  channel = 1,
  chunk = 2,
  drops = 3,
  warning = 4,
  snapshot = 5,
  measured = 6,
  answer = 17,
  done = 18,
  take = 19,
  stop = 20,
  /// Never sent: the supervisor is gone.
  gone = 21,
};

/// One to be sent.
class Packet {
 public:
  explicit Packet(Kind kind) { number(static_cast<std::uint32_t>(kind)); }

  template <class Number>
  Packet& number(Number value) {
    char bytes[sizeof value];
    std::memcpy(bytes, &value, sizeof value);
    content_.append(bytes, sizeof value);
    return *this;
  }

  Packet& text(std::string_view text) {
    number(static_cast<std::uint32_t>(text.size()));
    content_.append(text);
    return *this;
  }

  [[nodiscard]] const std::string& content() const { return content_; }

 private:
  std::string content_;
};

/// One that was received; a field that is not there is 0.
struct Request {
  Kind kind{};
  std::uint32_t number = 0;
  std::uint16_t channel = 0;

  static Request read(const char* data, std::size_t size) {
    Request request;
    std::memcpy(&request.kind, data, size < 4 ? 0 : 4);
    std::memcpy(&request.number, data + 4, size < 8 ? 0 : 4);
    std::memcpy(&request.channel, data + 8, size < 10 ? 0 : 2);
    return request;
  }
};

/// The socket to the supervisor. Sending never waits; a thread receives.
class SupervisorLink {
 public:
  /// `on_arrival` is called from the receiving thread when there is something to be taken.
  SupervisorLink(UniqueFd socket, std::function<void()> on_arrival);
  SupervisorLink(const SupervisorLink&) = delete;
  SupervisorLink& operator=(const SupervisorLink&) = delete;
  ~SupervisorLink();

  /// Sends a packet, or has it wait for `flush`. There must be few of them.
  void post(Packet packet);
  [[nodiscard]] bool is_waiting() const { return !waiting_.empty(); }
  /// Sends what waits; false when there is no room for all of it.
  bool flush();
  /// False when there is no room now, as the supervisor does not read. What cannot be sent because
  /// it is gone counts as sent: its end is seen by `requests`.
  bool send(const Packet& packet, int descriptor = -1);

  /// What has arrived; `gone` when the supervisor is.
  std::vector<Request> requests();

 private:
  void receive();

  const UniqueFd socket_;
  const std::function<void()> on_arrival_;
  std::deque<Packet> waiting_;
  std::mutex mutex_;
  std::vector<Request> requests_;
  std::thread receiver_;
};

}  // namespace play_launch::topics
