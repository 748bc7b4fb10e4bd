#pragma once

#include <pthread.h>

#include <array>
#include <climits>

namespace play_launch::isolation {

/// Destructors of thread_local objects and of values of pthread keys that a child's first thread
/// has. The C library keeps both with the donor's thread, and would run them at its end: in the
/// container, whatever they do. They belong to the child.
///
/// One on each donor, for one child. Not for a child after one that died: what that one left may be
/// half changed.
class ThreadDestructors {
 public:
  /// On the donor, before anything of a node: values of keys that it has by now stay its own. The
  /// allocator must have been used on it before, so that what it keeps for the thread is among
  /// them.
  ThreadDestructors() noexcept;
  ~ThreadDestructors();
  ThreadDestructors(const ThreadDestructors&) = delete;
  ThreadDestructors& operator=(const ThreadDestructors&) = delete;

  /// In the child's first thread: the donor's; null: it has none.
  static ThreadDestructors* of_donor() noexcept;

  /// In the child's first thread: runs them all, those that others register or set meanwhile, too.
  /// Values that are set again each time are dropped after PTHREAD_DESTRUCTOR_ITERATIONS rounds, as
  /// at the end of any thread. What a destructor throws ends in std::terminate().
  void run() noexcept;

  /// Finds out how to do that, the first time: before the first child, and not in one.
  static void prepare();
  /// Whether it is known. If not, they are never run, and a donor must not end like other threads.
  static bool can_run() noexcept;

 private:
  std::array<void*, PTHREAD_KEYS_MAX> donors_values_{};
};

}  // namespace play_launch::isolation
