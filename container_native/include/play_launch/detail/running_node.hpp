#pragma once

#include <string>

namespace play_launch::detail {

/// Marks the calling thread, while it lives, as one that runs code of a node: for naming the node
/// that did something to all. One marks a callback for the price of two stores.
class RunningNode {
 public:
  /// `name` is the node's full name, or that of its logger; it must outlive this object.
  explicit RunningNode(const char* name) noexcept;
  ~RunningNode();
  RunningNode(const RunningNode&) = delete;
  RunningNode& operator=(const RunningNode&) = delete;

  /// Full name of the node whose code the calling thread runs; empty: that is not known.
  [[nodiscard]] static std::string full_name();

 private:
  const char* const before_;
};

}  // namespace play_launch::detail
