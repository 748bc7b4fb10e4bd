#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>

namespace play_launch {
class Executor;
}

namespace play_launch::detail {

class StopFlag;

/// The container's access to executors; not for components.
struct ExecutorAccess {
  /// Executors that stop as well when `stop` is set. `threads` as for MultiThreadedExecutor.
  static std::unique_ptr<Executor> single_threaded(std::shared_ptr<StopFlag> stop);
  static std::unique_ptr<Executor> multi_threaded(std::size_t threads,
                                                  std::shared_ptr<StopFlag> stop);

  /// Before spin(): notes the time (nanoseconds of the steady clock) in `beat` whenever a thread of
  /// the executor looks for work, which one of them does once a second while idle. Only
  /// with all threads in callbacks, `beat` stands still. It must outlive spin().
  static void beat_into(Executor& executor, std::atomic<std::int64_t>& beat) noexcept;

  /// For an executor that spun in a process which shares this memory and has died: forgets the
  /// callbacks that were running, and destroys what they held. Afterwards nodes can be removed and
  /// the executor destroyed. The threads that were in spin() must be gone for good.
  static void abandon(Executor& executor);
};

}  // namespace play_launch::detail
