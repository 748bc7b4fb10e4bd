#pragma once

#include <rcl/node.h>

#include <atomic>
#include <functional>
#include <mutex>

namespace play_launch {

/// What others see of a node.
enum class HandleKind { node, publisher, subscription, service, client };

/// What the constructor of a component has taken from rcl and not given back yet. Should its
/// process die in there, no owner has these handles, and neither rcl nor rclcpp lists them; with
/// this, another process that shares the memory can take the half of a node off the network.
/// rcl_handles.cpp fills it, from all threads of the child: it belongs to the process and not to a
/// thread, so that the cleanup, a process of its own, has nothing to forget.
///
/// An entry is known by the address of its handle. Those of the SDK, rclcpp and rcl's own actions
/// and lifecycles stay where they were made; a component that moves a handle of its own, made with
/// rcl itself, may not die in its constructor.
class HandleLedger {
 public:
  HandleLedger() = default;
  /// What is still entered stays as it is.
  ~HandleLedger();
  HandleLedger(const HandleLedger&) = delete;
  HandleLedger& operator=(const HandleLedger&) = delete;

  /// While it lives, what is opened is entered. Afterwards the handles have owners.
  class Watch {
   public:
    explicit Watch(HandleLedger& ledger);
    ~Watch();
    Watch(const Watch&) = delete;
    Watch& operator=(const Watch&) = delete;

   private:
    HandleLedger& ledger_;
  };

  /// `node` is the one that the handle belongs to, or the handle itself.
  void opened(HandleKind kind, void* handle, const rcl_node_t* node) noexcept;
  /// The node is being entered in rcl's table of the nodes that log to /rosout.
  void logs(const rcl_node_t* node) noexcept;
  void closed(const void* handle) noexcept;

  // For the cleanup; all threads that could enter something are dead. The lock is not taken, as one
  // of them may have died with it.

  void for_each_node(const std::function<void(rcl_node_t&)>& visit) const;

  /// Calls a function with the lock that guards rcl's table of nodes that log to /rosout; false: it
  /// could not be called.
  using WithLoggingLock = std::function<bool(const std::function<void()>&)>;

  /// Finalises everything, the latest first.
  void give_back(const WithLoggingLock& with_logging_lock) noexcept;

 private:
  struct Entry;

  void clear() noexcept;

  /// Among the threads of the child. It guards the changes, each of which is a single store:
  /// wherever a thread is killed, the list is whole.
  std::mutex mutex_;
  bool watching_ = false;
  std::atomic<Entry*> newest_{nullptr};
};

}  // namespace play_launch
