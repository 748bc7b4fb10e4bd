#pragma once

#include <cstdint>
#include <mutex>
#include <optional>
#include <play_launch_msgs/msg/component_event.hpp>
#include <string>
#include <vector>

#include "control/channel.hpp"
#include "hosts/isolated/isolated_node.hpp"
#include "hosts/spawned/hosted_process.hpp"

namespace play_launch::container {

/// A node in a container of its own, which this one started and talks to on the control channel as
/// a supervisor does.
class HostedNode final : public IsolatedNode, private control::ChannelHandler {
 public:
  /// Starts the process, with `arguments`, and sends it the request. Throws std::exception.
  HostedNode(std::uint64_t unique_id, const std::vector<std::string>& arguments,
             LoadRequest request, int doorbell);
  ~HostedNode() override;

  void tell(NodeHostObserver& observer, IsolationTotals& totals) override;
  bool is_over() const override { return told_end_; }
  int watched_fd() const override { return dead_ ? -1 : process_->fd(); }

 private:
  using ComponentEvent = play_launch_msgs::msg::ComponentEvent;

  bool is_dead() const override { return dead_; }
  const LoadRequest& request() const override { return request_; }
  std::string full_name() const override;
  void ask_to_leave() override;
  bool signal(int number) override {
    process_->signal(number);
    return true;
  }

  void on_frame(const control::Frame& frame) override;
  void on_closed() override;
  void on_protocol_error(const std::string& what) override;

  void tell_loaded(NodeHostObserver& observer, const ComponentEvent& loaded);
  void tell_end(NodeHostObserver& observer, IsolationTotals& totals);

  const LoadRequest request_;
  std::optional<HostedProcess> process_;
  std::optional<control::Channel> channel_;

  mutable std::mutex mutex_;  // guards what its container has told
  std::optional<ComponentEvent> loaded_;
  std::optional<ComponentEvent> failed_;
  std::optional<ComponentEvent> unloaded_;
  bool closed_ = false;

  // The monitor's.
  bool told_constructing_ = false;
  bool told_loaded_ = false;
  bool dead_ = false;
  bool told_end_ = false;
};

}  // namespace play_launch::container
