#pragma once

#include <rcl/context.h>

#include <functional>
#include <memory>
#include <mutex>
#include <vector>

namespace play_launch {

namespace detail {
class StopFlag;
struct ContextAccess;
}  // namespace detail

class IntraProcessHub;

/// One rcl context, which means one participant on the network, shared by all nodes made with it.
/// All members may be called from any thread.
class Context {
 public:
  /// Initialises a context of its own and, for the first one of the process, logging.
  /// `argv` is the command line; what follows `--ros-args` applies to every node that uses global
  /// arguments. Throws RclError.
  static std::shared_ptr<Context> create(int argc, const char* const* argv);

  ~Context();
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;

  /// The underlying context; valid as long as this object.
  [[nodiscard]] rcl_context_t* rcl() noexcept { return context_; }

  /// False after the context was shut down.
  [[nodiscard]] bool ok() const noexcept;

  /// Cancels every executor that ever held a node of this context and invalidates the context.
  /// Idempotent. In a container, where all nodes share the context, it is a request that the
  /// container decides on: an isolated node ends alone, any other one ends the container; the
  /// context stays valid.
  void shutdown();

 private:
  friend struct detail::ContextAccess;

  Context();

  void end();

  rcl_context_t own_;
  rcl_context_t* context_ = nullptr;
  bool owns_logging_ = false;
  std::unique_ptr<IntraProcessHub> hub_;
  std::mutex mutex_;
  bool shut_down_ = false;
  std::function<bool(const void* caller)> guard_;
  std::vector<std::weak_ptr<detail::StopFlag>> stops_;
};

}  // namespace play_launch
