#pragma once

#include <memory>
#include <mutex>
#include <vector>

namespace play_launch {

class NodeSlot;
class Waitable;
class WakeToken;

/// What a node has for executors, and which executor the node is in.
class WaitableRegistry {
 public:
  /// Adds a waitable, for the executor too if there is one.
  void add(const std::shared_ptr<Waitable>& waitable);

  /// Claims the node for an executor. Throws std::logic_error when another has it.
  void hold();
  /// Connects all present and future waitables to that place in the executor.
  void attach(std::shared_ptr<NodeSlot> slot);
  /// Disconnects all. The node stays claimed until release().
  void detach();
  void release();

 private:
  std::mutex mutex_;
  bool held_ = false;
  std::shared_ptr<NodeSlot> slot_;
  std::vector<std::shared_ptr<WakeToken>> tokens_;
  std::size_t prune_at_ = 32;
};

}  // namespace play_launch
