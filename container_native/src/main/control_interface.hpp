#pragma once

#include <cstdint>
#include <functional>
#include <play_launch_msgs/msg/control_hello.hpp>
#include <string>

#include "control/channel.hpp"
#include "main/stop.hpp"
#include "manager/component_manager.hpp"

namespace play_launch::container {

/// The supervisor's side of the container: turns frames into calls of the manager, and its answers
/// and events into frames.
class ControlInterface final : public EventSink, public control::ChannelHandler {
 public:
  /// Notices the end of the channel from now on. `on_lost` is called, in the channel's thread,
  /// before the stop is asked for when the channel has ended.
  ControlInterface(UniqueFd socket, StopRequests& stop, std::function<void()> on_lost);

  /// Says hello and begins to obey. `manager` must outlive close().
  void open(ObservableComponentManager& manager, const play_launch_msgs::msg::ControlHello& hello);

  /// Waits until the peer has read everything, but no longer than that. Then nothing is read or
  /// sent any more.
  void close(SteadyTime deadline);

  void on_event(const ComponentEvent& event) override;

  void on_frame(const control::Frame& frame) override;
  void on_closed() override;
  void on_protocol_error(const std::string& what) override;

 private:
  template <class Message>
  void send(control::FrameKind kind, const Message& message);
  void reject(std::uint64_t attempt, std::uint64_t unique_id, const std::string& reason);
  bool understands(const control::Frame& frame);
  void handle_hello(const control::Frame& frame);
  void handle_load(const control::Frame& frame);
  void handle_query(const control::Frame& frame);
  void handle_cancel(const control::Frame& frame);
  void handle_unload(const control::Frame& frame);

  StopRequests& stop_;
  const std::function<void()> on_lost_;
  ObservableComponentManager* manager_ = nullptr;
  bool foreign_version_ = false;  // only the channel's thread's
  control::Channel channel_;      // last: its thread uses the above
};

/// The socket of that type whose number the environment variable has, kept from programs that nodes
/// start; the variable is removed. Without the variable an empty one. Throws std::runtime_error
/// when it names none. Call it before there are threads.
UniqueFd take_socket(const char* variable, int type);

}  // namespace play_launch::container
