#pragma once

#include <pthread.h>

#include <cstddef>
#include <functional>
#include <string>

#include "base/scheduling.hpp"
#include "isolation/record/crash_slot.hpp"

namespace play_launch::isolation {

/// A thread that lends itself to children: its body calls run_in_child() as often as it likes.
///
/// After a child that did not come to its end (ChildEnd::returned is false) the body must not
/// allocate, free, or touch thread_local objects with destructors: the child may have left them
/// half changed. It can run another child, write to an eventfd, store into atomics, and return.
/// Therefore keep everything else out of it: leave it to another thread.
///
/// When the body returns, the thread ends without running any destructor of thread-local storage,
/// which would be the child's. One more short-lived child frees what the allocator keeps for the
/// thread; if that fails, the memory is lost.
class DonorThread {
 public:
  /// Starts the thread. `name` as for ChildOptions. `ended` is called on the thread when nothing is
  /// left that takes time: join() returns soon then. Neither must throw, and what holds for the
  /// body after a child holds for `ended`. Throws std::system_error.
  DonorThread(const std::string& name, std::function<void()> body,
              std::function<void()> ended = nullptr);
  DonorThread(const DonorThread&) = delete;
  DonorThread& operator=(const DonorThread&) = delete;
  /// Joins.
  ~DonorThread();

  /// Has the thread run more urgently, as far as the kernel agrees; not the children. Any thread.
  void rise(Urgency urgency) noexcept { rank_.rise(urgency); }

  /// Waits until the body has returned, and gives the stack back. Only once, or never.
  void join();

 private:
  static void* start(void* self);

  std::function<void()> body_;
  std::function<void()> ended_;
  std::string name_;
  void* mapping_ = nullptr;
  std::size_t mapping_size_ = 0;
  pthread_t thread_{};
  bool joinable_ = false;
  Rank rank_;
};

/// On a donor, after the death of the child that wrote the slot: gives back what the allocator
/// keeps for its threads that were at rest, where it has a function for that
/// (mimalloc). Without this, each thread that dies leaves its heap behind. And
/// forgets their values of pthread_key_create()'s keys: the C library gives the stack of a joined
/// thread, with these, to another one, whose end would give the same heap back once more. Done in a
/// child of its own with a time limit, which speaks for one dead thread after the other; before
/// the threads' stacks are freed, in which the C library keeps their thread-local storage.
/// True: all that could be was given back. Neither allocates nor takes a lock.
bool give_back_heaps(const CrashSlot& slot) noexcept;

}  // namespace play_launch::isolation
