#pragma once

#include <rcl/context.h>

#include <functional>
#include <memory>
#include <mutex>
#include <vector>

namespace play_launch {

namespace detail {
class StopFlag;
}

class IntraProcessHub;

/// One rcl context, which means one participant on the network, shared by all nodes made with it.
/// All members may be called from any thread.
class Context {
 public:
  /// Initialises a context of its own and, for the first one of the process, logging.
  /// `argv` is the command line; what follows `--ros-args` applies to every node that uses global
  /// arguments. Throws RclError.
  static std::shared_ptr<Context> create(int argc, const char* const* argv);

  /// Uses a context that somebody else initialised and will finalise; it must outlive this object
  /// and every node made with it. Logging is left as the owner configured it.
  static std::shared_ptr<Context> borrow(rcl_context_t* context);

  ~Context();
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;

  /// The underlying context; valid as long as this object.
  [[nodiscard]] rcl_context_t* rcl() noexcept { return context_; }

  /// False after shutdown(), or after the owner of a borrowed context shut it down.
  [[nodiscard]] bool ok() const noexcept;

  /// Cancels every executor that ever held a node of this context and invalidates the context
  /// (a borrowed one stays valid: shutting it down is its owner's business). Idempotent. In a
  /// container, where the context is everybody's, it is a request that the container decides on:
  /// an isolated node ends alone, any other one ends the container; the context stays valid.
  void shutdown();

  /// For the owner of a context that nodes share: decides on their calls of shutdown(). It is given
  /// the address that the call returns to, and answers whether the context is shut down. Before
  /// the first node; none: nobody decides.
  using ShutdownGuard = std::function<bool(const void* caller)>;
  void guard_shutdown(ShutdownGuard guard);
  /// Asks the guard, for a shutdown that does not come through shutdown().
  [[nodiscard]] bool may_shut_down(const void* caller);

  /// Where publishers and subscriptions of this context meet without the middleware.
  [[nodiscard]] IntraProcessHub& intra_process() noexcept { return *hub_; }

  /// Has `stop` set on shutdown(). Used by executors.
  void stop_on_shutdown(const std::shared_ptr<detail::StopFlag>& stop);

 private:
  Context();

  void end();

  rcl_context_t own_;
  rcl_context_t* context_ = nullptr;
  bool owns_logging_ = false;
  std::unique_ptr<IntraProcessHub> hub_;
  std::mutex mutex_;
  bool shut_down_ = false;
  ShutdownGuard guard_;
  std::vector<std::weak_ptr<detail::StopFlag>> stops_;
};

}  // namespace play_launch
