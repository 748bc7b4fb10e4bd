#pragma once

#include <rcl/node.h>

#include <memory>
#include <play_launch/detail/construction.hpp>
#include <vector>

namespace play_launch::rclcpp_backend {

/// What others see of a node.
enum class HandleKind { node, publisher, subscription, service, client };

/// Keeps track of what the constructor of a component takes from rcl in the calling thread, while
/// this object lives. It is entered in the Construction that is watched there: should the process
/// die in the constructor, another one can take the half of a node off the network. rclcpp itself
/// has no list of these; rcl_hooks.cpp sees the calls.
class HandleLedger {
 public:
  HandleLedger();
  ~HandleLedger();
  HandleLedger(const HandleLedger&) = delete;
  HandleLedger& operator=(const HandleLedger&) = delete;

  /// That of the calling thread; null when none lives.
  static HandleLedger* current() noexcept;

  /// `node` is the one that the handle belongs to, or the handle itself.
  void opened(HandleKind kind, void* handle, const rcl_node_t* node);
  void closed(const void* handle) noexcept;

  /// While it lives, nothing is entered: for what rcl itself takes and gives back.
  class Pause {
   public:
    Pause() noexcept;
    ~Pause();
    Pause(const Pause&) = delete;
    Pause& operator=(const Pause&) = delete;

   private:
    HandleLedger* const before_;
  };

 private:
  class Entry;

  std::vector<std::unique_ptr<Entry>> entries_;
};

/// Finalises the halves of nodes that were discarded. Only for who holds rclcpp's lock for logging,
/// which guards the table of publishers for /rosout.
void finalise_discarded_nodes() noexcept;

}  // namespace play_launch::rclcpp_backend
