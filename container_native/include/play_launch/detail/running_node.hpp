#pragma once

#include <string>

namespace play_launch {
class Logger;
}

namespace play_launch::detail {

/// Marks the calling thread, while it lives, as one that runs code of a node: for naming the node
/// that did something to all. One marks a callback for the price of a few stores.
class RunningNode {
 public:
  /// `name` is the node's full name; it must outlive this object.
  explicit RunningNode(const char* name) noexcept : RunningNode(name, nullptr) {}
  /// A node of the SDK, by its logger, which must outlive this object.
  explicit RunningNode(const Logger& logger) noexcept : RunningNode(nullptr, &logger) {}
  virtual ~RunningNode();
  RunningNode(const RunningNode&) = delete;
  RunningNode& operator=(const RunningNode&) = delete;

  /// Full name of the node whose code the calling thread runs; empty: that is not known.
  [[nodiscard]] static std::string full_name();

  /// In a terminate handler: if an exception is why it is called, and the calling thread runs code
  /// of a node that is known, logs both as FATAL.
  static void log_uncaught_exception() noexcept;

 protected:
  /// For a node whose name is looked up on request only: in the marked thread.
  RunningNode() noexcept : RunningNode(nullptr, nullptr) {}
  /// Full name; empty: not known.
  virtual std::string name() const;

 private:
  RunningNode(const char* name, const Logger* logger) noexcept;

  const char* const name_;
  const Logger* const logger_;
  const RunningNode* const before_;
};

}  // namespace play_launch::detail
