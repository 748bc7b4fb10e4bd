#pragma once

#include <linux/futex.h>
#include <locale.h>
#include <sys/types.h>

#include <cstddef>
#include <cstdint>

namespace play_launch::isolation {

/// What the C and C++ libraries keep for the thread that becomes a donor, so that a child which
/// died anywhere leaves it as it was. Blocks all signals while it exists. Async-signal-safe.
class DonorState {
 public:
  DonorState() noexcept;
  /// In the donor, when the child is gone.
  ~DonorState();
  DonorState(const DonorState&) = delete;
  DonorState& operator=(const DonorState&) = delete;

  /// In the child's first thread: makes the thread's record true for the child where the kernel and
  /// the C library must agree: the thread's id (mutexes with priority inheritance, pthread_set*()
  /// for the thread itself), the list of robust mutexes, restartable sequences.
  void adopt() const noexcept;

  /// Looks up where the C library keeps the id of a thread. Not async-signal-safe.
  static void prepare();

 private:
  struct ExceptionState {  // __cxa_eh_globals of the C++ ABI
    void* caught;
    unsigned uncaught;
  };

  int errno_;
  std::uint64_t signal_mask_ = 0;  // the kernel's format
  locale_t locale_;
  ExceptionState* exceptions_;
  ExceptionState exceptions_before_;
  robust_list_head* robust_list_ = nullptr;
  std::size_t robust_list_size_ = 0;
  robust_list_head robust_list_before_{};
  pid_t* thread_id_;  // null: not found, stays as it is
};

}  // namespace play_launch::isolation
