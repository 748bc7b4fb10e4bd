#pragma once

#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "base/unique_fd.hpp"
#include "control/frames.hpp"

namespace play_launch::control {

/// Environment variable with the number of the socket to the supervisor.
inline constexpr const char* kSocketVariable = "PLAY_LAUNCH_CONTROL_FD";

/// Receives what comes in on a Channel. All calls come from the channel's thread.
class ChannelHandler {
 public:
  virtual ~ChannelHandler() = default;
  /// May throw ProtocolError, which is treated like a broken frame.
  virtual void on_frame(const Frame& frame) = 0;
  /// The peer closed its end or is gone. The last call.
  virtual void on_closed() = 0;
  /// The peer broke the protocol. The last call.
  virtual void on_protocol_error(const std::string& what) = 0;
};

/// One end of the control channel: frames over a stream socket.
///
/// A thread reads, and writes what the socket does not take at once, so that no thread that sends
/// or handles a frame ever waits for the peer. These frames wait in a queue of bounded length; one
/// that finds it full is dropped and counted, which leaves the order of the others as it was. Once
/// the peer has closed its end, or broken the protocol, only what the socket takes at once goes
/// out.
class Channel {
 public:
  static constexpr std::size_t kQueueCapacity = 4096;  // frames

  explicit Channel(UniqueFd socket, std::size_t queue_capacity = kQueueCapacity);
  Channel(const Channel&) = delete;
  Channel& operator=(const Channel&) = delete;
  ~Channel();

  /// Starts the thread. Until open_gate() incoming frames are left in the socket, but the end
  /// of the stream is noticed: a peer that dies while this process starts must not be missed.
  void start(ChannelHandler& handler);
  void open_gate();

  /// Sends or queues a frame; never blocks. False: it was dropped, because the queue was full or
  /// the peer is gone.
  bool send(FrameKind kind, std::span<const std::uint8_t> payload);

  /// Waits until everything queued so far went out. False: not by the deadline, or the peer is
  /// gone.
  bool flush(std::chrono::steady_clock::time_point deadline);

  /// The peer has sent its last frame. What is in the socket is still handled, and then comes
  /// on_closed(), even if another process holds the peer's end open. Any thread.
  void expect_no_more();

  /// Whether its socket is still the one that it was made with: code in this process may have
  /// closed the descriptor, or put another file in its place. Then on_closed() does not mean the
  /// end of the peer.
  bool has_its_socket() const noexcept;

  /// Frames that send() dropped since the start.
  std::uint64_t dropped() const { return dropped_.load(std::memory_order_relaxed); }

  /// Ends the thread; frames still queued are lost. No call to the handler comes afterwards.
  void stop();

 private:
  void serve();
  bool is_waiting_to_write();
  void write_waiting();

  const UniqueFd socket_;
  const ino_t socket_inode_;
  const UniqueFd wake_;
  const std::size_t capacity_;
  ChannelHandler* handler_ = nullptr;

  std::atomic<bool> stopping_{false};
  std::atomic<bool> gate_open_{false};
  std::atomic<std::uint64_t> dropped_{0};

  std::mutex mutex_;  // guards what follows
  std::condition_variable changed_;
  std::deque<std::vector<std::uint8_t>> queue_;
  std::size_t written_ = 0;  // of the first one in the queue, in bytes
  bool broken_ = false;      // the peer does not read any more

  std::thread thread_;
};

}  // namespace play_launch::control
