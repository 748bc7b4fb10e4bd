#include "isolation/clone/donor_state.hpp"

#include <cxxabi.h>
#include <dlfcn.h>
#include <pthread.h>
#include <signal.h>
#include <sys/syscall.h>
#include <unistd.h>

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
constexpr std::uint32_t kRseqSize = 32;  // of the area's first version, which all kernels take

long rseq(int flags) noexcept {
  if (__rseq_size == 0) {
    return 0;  // the C library did not register it, so it is not used
  }
  char* const area = static_cast<char*>(__builtin_thread_pointer()) + __rseq_offset;
  return ::syscall(SYS_rseq, area, kRseqSize, flags, RSEQ_SIG);
}
#endif

void register_rseq() noexcept {
#ifdef RSEQ_SIG
  rseq(0);
#endif
}

/// The child wrote its CPU into the area; the kernel does not know that for the donor.
void renew_rseq() noexcept {
#ifdef RSEQ_SIG
  if (rseq(RSEQ_FLAG_UNREGISTER) == 0) {
    rseq(0);
  }
#endif
}

}  // namespace

void DonorState::prepare() {
  // The description of its thread record that the C library keeps for debuggers: bits, count,
  // offset.
  const auto* const field = static_cast<const std::uint32_t*>(
      ::dlvsym(RTLD_DEFAULT, "_thread_db_pthread_tid", "GLIBC_PRIVATE"));
  if (field == nullptr || field[0] != sizeof(pid_t) * CHAR_BIT || field[1] != 1) {
    return;
  }
  thread_id_offset = field[2];
  if (stored_thread_id() == nullptr) {
    thread_id_offset = 0;
  }
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
}

void DonorState::adopt() const noexcept {
  if (thread_id_ != nullptr) {
    *thread_id_ = ::gettid();
  }
  if (robust_list_ != nullptr) {
    ::syscall(SYS_set_robust_list, robust_list_, robust_list_size_);
  }
  register_rseq();
}

DonorState::~DonorState() {
  if (thread_id_ != nullptr) {
    *thread_id_ = ::gettid();
  }
  if (robust_list_ != nullptr) {
    *robust_list_ = robust_list_before_;
  }
  renew_rseq();
  *exceptions_ = exceptions_before_;
  ::uselocale(locale_);
  exchange_signal_mask(signal_mask_);
  errno = errno_;
}

}  // namespace play_launch::isolation
