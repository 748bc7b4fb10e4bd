#pragma once

#include <linux/futex.h>
#include <locale.h>
#include <sys/types.h>

#include <cstddef>
#include <cstdint>

namespace play_launch::isolation {

/// What the C and C++ libraries keep for the thread that becomes a donor, so that a child which
/// died anywhere leaves it as it was. While it exists, all signals are blocked, and no thread can
/// cancel the thread: that would unwind into its first frames, in the child. Async-signal-safe.
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

  /// Finds out where the C library keeps the id of a thread, and how it registered its restartable
  /// sequences. Null, or a text with what could not be found. Not async-signal-safe.
  static const char* prepare();

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
  pid_t* thread_id_;
  int cancel_state_ = 0;
  bool has_rseq_ = false;
};

}  // namespace play_launch::isolation
