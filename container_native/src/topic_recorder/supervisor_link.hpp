#pragma once

#include <deque>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include "base/unique_fd.hpp"
#include "topic_recorder/packet.hpp"

namespace play_launch::topics {

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
