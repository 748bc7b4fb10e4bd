#pragma once

#include <rcl/context.h>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>

namespace play_launch {
class Context;
class Executor;
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

/// The container's access to executors; not for components.
struct ExecutorAccess {
  /// Executors that stop as well when `stop` is set. `threads` as for MultiThreadedExecutor.
  static std::unique_ptr<Executor> single_threaded(std::shared_ptr<StopFlag> stop);
  static std::unique_ptr<Executor> multi_threaded(std::size_t threads,
                                                  std::shared_ptr<StopFlag> stop);

  /// Before spin(): notes the time (nanoseconds of the steady clock) in `beat` whenever a thread of
  /// the executor looks for work, which one of them does once a second while idle. Only
  /// with all threads in callbacks, `beat` stands still. It must outlive spin().
  /// A thread that takes a message, or another piece of work, from the middleware has the time when
  /// it began in a place of `takes`, which is 0 otherwise.
  static void beat_into(Executor& executor, std::atomic<std::int64_t>& beat,
                        std::span<std::atomic<std::int64_t>> takes) noexcept;

  /// For an executor that spun in a process which shares this memory and has died: forgets the
  /// callbacks that were running, and destroys what they held. Afterwards nodes can be removed and
  /// the executor destroyed. The threads that were in spin() must be gone for good.
  static void abandon(Executor& executor);
};

}  // namespace play_launch::detail
