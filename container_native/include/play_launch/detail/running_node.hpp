#pragma once

#include <string>

namespace play_launch::detail {

/// Marks the calling thread, while it lives, as one that runs code of a node: for naming the node
/// that did something to all. One marks a callback for the price of a few stores.
class RunningNode {
 public:
  /// `name` is the node's full name, or that of its logger; it must outlive this object.
  explicit RunningNode(const char* name) noexcept;
  virtual ~RunningNode();
  RunningNode(const RunningNode&) = delete;
  RunningNode& operator=(const RunningNode&) = delete;

  /// Full name of the node whose code the calling thread runs; empty: that is not known.
  [[nodiscard]] static std::string full_name();

 protected:
  /// For a node whose name is only looked for when somebody asks: in the marked thread.
  RunningNode() noexcept : RunningNode(nullptr) {}
  /// What the constructor takes; empty: not known.
  virtual std::string name() const;

 private:
  const char* const name_;
  const RunningNode* const before_;
};

}  // namespace play_launch::detail
