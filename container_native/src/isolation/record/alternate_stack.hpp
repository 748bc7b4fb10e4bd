#pragma once

#include <cstddef>

namespace play_launch::isolation {

/// Where crash handlers run, also when the stack has overflowed: memory with a page below it that
/// faults. Async-signal-safe.
class AlternateStack {
 public:
  /// False when there is no memory to be had.
  AlternateStack() noexcept;
  ~AlternateStack();
  AlternateStack(const AlternateStack&) = delete;
  AlternateStack& operator=(const AlternateStack&) = delete;

  explicit operator bool() const { return mapping_ != nullptr; }

  /// Makes it the calling thread's.
  void use() const noexcept;
  /// The calling thread has none any more.
  static void stop_using() noexcept;

  /// Leaves it to another thread, which calls give_back().
  void* release() noexcept;
  static void give_back(void* released) noexcept;

 private:
  void* mapping_ = nullptr;
};

}  // namespace play_launch::isolation
