#pragma once

#include <rcl/context.h>

#include <functional>
#include <memory>

namespace play_launch {
class Context;
class IntraProcessHub;
}  // namespace play_launch

namespace play_launch::detail {

class StopFlag;

/// What the container and the rest of the SDK do with contexts. Any thread.
struct ContextAccess {
  /// Uses a context that the caller initialised and will finalise; it must outlive the result
  /// and every node made with it. Logging is left as the owner configured it. Its shutdown() stops
  /// executors and leaves the context valid. Throws RclError.
  static std::shared_ptr<Context> borrow(rcl_context_t* context);

  /// For the owner of a context that nodes share: decides on their calls of shutdown(). It is given
  /// the address that the call returns to, and answers whether the context is shut down. Before
  /// the first node; none: no decision is made.
  using ShutdownGuard = std::function<bool(const void* caller)>;
  static void guard_shutdown(Context& context, ShutdownGuard guard);
  /// Asks the guard, for a shutdown that does not come through shutdown().
  [[nodiscard]] static bool may_shut_down(Context& context, const void* caller);

  /// Where publishers and subscriptions of this context meet without the middleware.
  [[nodiscard]] static IntraProcessHub& intra_process(Context& context) noexcept;

  /// Has `stop` set on shutdown().
  static void stop_on_shutdown(Context& context, const std::shared_ptr<StopFlag>& stop);
};

}  // namespace play_launch::detail
