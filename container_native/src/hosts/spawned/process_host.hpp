#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/process.hpp"
#include "base/unique_fd.hpp"
#include "control/channel.hpp"
#include "hosts/isolated/isolated_host.hpp"
#include "hosts/isolated/isolated_node.hpp"

namespace play_launch::container {

/// With processes that have memory of their own: the mechanism process. Each is this program once
/// more, as a container of one node; messages between nodes go through the middleware.
class ProcessHost final : public IsolatedHost {
 public:
  /// `executor` is that of each node; `core_dumps`: nodes that crash dump core; `ros_arguments` are
  /// what stands behind --ros-args.
  ProcessHost(BackendList backends, const ExecutorChoice& executor, bool core_dumps,
              const std::vector<std::string>& ros_arguments);

 private:
  std::shared_ptr<IsolatedNode> start(std::uint64_t unique_id, LoadRequest request,
                                      NodeResources resources, int event_fd) override;

  std::vector<std::string> arguments_;
  std::vector<std::string> ros_arguments_;
};

/// A node in a container of its own, which this one started and talks to on the control channel as
/// a supervisor does. Its process exits when the other end of the channel is closed, so with this
/// container at the latest.
class HostedNode final : public IsolatedNode, private control::ChannelHandler {
 public:
  /// Starts the process, with `arguments`, and sends it the request. Throws std::exception.
  HostedNode(std::uint64_t unique_id, const std::vector<std::string>& arguments,
             LoadRequest request, int event_fd);
  ~HostedNode() override;

  int watched_fd() const override { return is_reaped_ ? -1 : process_fd_.get(); }

 private:
  NodeLife look() override;
  const LoadRequest& request() const override { return request_; }
  ProcessIdentity process() const override { return process_; }
  std::string full_name() const override;
  std::string failure() const override { return failure_; }
  std::string why_it_left() const override { return why_it_left_; }
  NodeDeath death() override { return death_; }
  bool is_cleaned_up() override { return true; }  // by the kernel
  void ask_to_leave() override;
  bool signal(int number) override;

  void on_frame(const control::Frame& frame) override;
  void on_closed() override;
  void on_protocol_error(const std::string& what) override;

  void note(NodeLife part, std::string& text, const std::string& what);
  void reap(int options);

  const LoadRequest request_;
  ProcessIdentity process_;
  UniqueFd process_fd_;  // readable when it is dead
  bool is_reaped_ = false;
  NodeDeath death_;  // when it is reaped

  // Written by the thread that reads the channel, once each, before the life has the part.
  std::string full_name_;    // NodeLife::spinning
  std::string failure_;      // NodeLife::failed
  std::string why_it_left_;  // NodeLife::left
  LifeRecord life_;
  std::atomic<bool> is_asked_{false};  // to leave
  std::atomic<bool> closed_{false};    // everything that it wrote is read

  std::optional<control::Channel> channel_;  // last: its thread uses all of the above
};

}  // namespace play_launch::container
