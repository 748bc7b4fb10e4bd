#pragma once

#include <list>

namespace play_launch {

struct ReadyEntry;

/// Decides which callbacks of a node may run at the same time in a multi-threaded executor.
/// Belongs to one node; made by Node::create_callback_group.
class CallbackGroup {
 public:
  enum class Kind {
    mutually_exclusive,  ///< one callback of the group at a time, in the order they became ready
    reentrant,           ///< any number at once, even the same callback with several messages
  };

  explicit CallbackGroup(Kind kind);
  ~CallbackGroup();
  CallbackGroup(const CallbackGroup&) = delete;
  CallbackGroup& operator=(const CallbackGroup&) = delete;

  [[nodiscard]] Kind kind() const noexcept { return kind_; }

 private:
  friend class Scheduler;

  const Kind kind_;
  // Guarded by the executor that holds the group's node.
  std::list<ReadyEntry> waiting_;
  bool scheduled_ = false;  // has its turn, or waits for it
};

}  // namespace play_launch
