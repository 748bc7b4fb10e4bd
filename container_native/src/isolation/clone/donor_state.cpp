#include "isolation/clone/donor_state.hpp"

#include <cxxabi.h>
#include <dlfcn.h>
#include <pthread.h>
#include <signal.h>
#include <sys/auxv.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <climits>

#include "isolation/record/own_signals.hpp"

#if __has_include(<sys/rseq.h>)
#include <sys/rseq.h>
#endif

namespace play_launch::isolation {
namespace {

constexpr std::uint64_t kAllSignals = ~std::uint64_t{0};

/// Of the id of a thread in what pthread_self() points to; 0: unknown.
std::atomic<std::uint32_t> thread_id_offset{0};

pid_t* stored_thread_id() noexcept {
  const std::uint32_t offset = thread_id_offset.load(std::memory_order_relaxed);
  if (offset == 0) {
    return nullptr;
  }
  auto* const id = reinterpret_cast<pid_t*>(::pthread_self() + offset);
  return *id == ::gettid() ? id : nullptr;
}

#ifdef RSEQ_SIG
constexpr std::uint32_t kRseqFirstLength = 32;
constexpr std::uint32_t kRseqCriticalSection = 8;  // offset in the area

/// Bytes of the area that the C library registered for each thread; 0: it did not.
std::atomic<std::uint32_t> rseq_length{0};

char* rseq_area() noexcept {
  return static_cast<char*>(__builtin_thread_pointer()) + __rseq_offset;
}

bool set_rseq(std::uint32_t length, int flags) noexcept {
  return length != 0 && ::syscall(SYS_rseq, rseq_area(), length, flags, RSEQ_SIG) == 0;
}

bool register_rseq() noexcept { return set_rseq(rseq_length, 0); }
bool unregister_rseq() noexcept { return set_rseq(rseq_length, RSEQ_FLAG_UNREGISTER); }

/// A dead child's critical section does not belong to this thread.
void leave_critical_section() noexcept {
  *reinterpret_cast<volatile std::uint64_t*>(rseq_area() + kRseqCriticalSection) = 0;
}

/// The kernel only takes the length that was registered: finds out which one that is.
bool find_rseq_length() {
  if (__rseq_size == 0) {
    return true;
  }
#ifdef AT_RSEQ_FEATURE_SIZE
  const std::uint64_t alignment = std::max(::getauxval(AT_RSEQ_ALIGN), 1UL);
  const std::uint64_t size = ::getauxval(AT_RSEQ_FEATURE_SIZE);
  const auto whole = static_cast<std::uint32_t>((size + alignment - 1) / alignment * alignment);
#else
  const std::uint32_t whole = kRseqFirstLength;
#endif
  for (const std::uint32_t length : {kRseqFirstLength, whole}) {
    if (set_rseq(length, RSEQ_FLAG_UNREGISTER)) {
      rseq_length = length;
      return register_rseq();
    }
  }
  return false;
}
#else
bool register_rseq() noexcept { return false; }
bool unregister_rseq() noexcept { return false; }
void leave_critical_section() noexcept {}
bool find_rseq_length() { return true; }
#endif

bool find_thread_id() {
  // The description of its thread record that the C library keeps for debuggers: bits, count,
  // offset.
  const auto* const field = static_cast<const std::uint32_t*>(
      ::dlvsym(RTLD_DEFAULT, "_thread_db_pthread_tid", "GLIBC_PRIVATE"));
  if (field == nullptr || field[0] != sizeof(pid_t) * CHAR_BIT || field[1] != 1) {
    return false;
  }
  thread_id_offset = field[2];
  return stored_thread_id() != nullptr;
}

}  // namespace

const char* DonorState::prepare() {
  // Without it, setuid() and the like in the container would wait for the answer of a thread that
  // gives none while its child lives.
  if (!find_thread_id()) {
    return "the C library does not say where it keeps the id of a thread";
  }
  if (!find_rseq_length()) {
    return "the C library's restartable sequences cannot be handed from thread to thread";
  }
  return nullptr;
}

DonorState::DonorState() noexcept
    : errno_(errno),
      signal_mask_(exchange_signal_mask(kAllSignals)),
      locale_(::uselocale(nullptr)),
      exceptions_(reinterpret_cast<ExceptionState*>(abi::__cxa_get_globals())),
      exceptions_before_(*exceptions_),
      thread_id_(stored_thread_id()) {
  if (::syscall(SYS_get_robust_list, 0, &robust_list_, &robust_list_size_) != 0) {
    robust_list_ = nullptr;
  }
  if (robust_list_ != nullptr) {
    robust_list_before_ = *robust_list_;
  }
  ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, &cancel_state_);
  // The donor goes through user mode while the child lives (at its birth, after a stop, under a
  // debugger). The kernel would then write the donor's CPU into the area that is the child's, and
  // end its critical sections.
  has_rseq_ = unregister_rseq();
}

void DonorState::adopt() const noexcept {
  if (thread_id_ != nullptr) {
    *thread_id_ = ::gettid();
  }
  if (robust_list_ != nullptr) {
    ::syscall(SYS_set_robust_list, robust_list_, robust_list_size_);
  }
  if (has_rseq_) {
    register_rseq();
  }
}

DonorState::~DonorState() {
  if (thread_id_ != nullptr) {
    *thread_id_ = ::gettid();
  }
  if (robust_list_ != nullptr) {
    *robust_list_ = robust_list_before_;
  }
  if (has_rseq_) {
    leave_critical_section();
    register_rseq();
  }
  ::pthread_setcancelstate(cancel_state_, nullptr);
  *exceptions_ = exceptions_before_;
  ::uselocale(locale_);
  exchange_signal_mask(signal_mask_);
  errno = errno_;
}

}  // namespace play_launch::isolation
