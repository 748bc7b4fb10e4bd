#include "isolation/record/child_threads.hpp"

#include <cxxabi.h>
#include <linux/futex.h>
#include <pthread.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <climits>

#include "isolation/record/alternate_stack.hpp"
#include "isolation/record/graveyard.hpp"

namespace play_launch::isolation {

namespace {

/// Stores the initial value and wakes the waiting threads. Through the kernel: the memory may be
/// gone, or be private to the dead node.
void reset(std::uintptr_t once) noexcept {
  static_assert(PTHREAD_ONCE_INIT == 0 && sizeof(pthread_once_t) == sizeof(std::uint32_t));
  constexpr int kStoreZero = FUTEX_OP(FUTEX_OP_SET, PTHREAD_ONCE_INIT, FUTEX_OP_CMP_EQ, 0);
  ::syscall(SYS_futex, once, FUTEX_WAKE_OP_PRIVATE, INT_MAX, 0, once, kStoreZero);
}

}  // namespace

void Initialisations::undo() noexcept {
  for (auto& place : begun_) {
    const std::uintptr_t begun = place.exchange(0);
    const std::uintptr_t control = begun & ~std::uintptr_t{1};
    if (control == 0) {
      continue;
    }
    if (begun != control) {
      reset(control);
    } else if (*reinterpret_cast<const volatile char*>(control) == 0) {  // else it was finished
      abi::__cxa_guard_abort(reinterpret_cast<abi::__guard*>(control));
    }
  }
}

ChildThreads::Entry::Entry(ChildThreads& threads) noexcept : threads_(threads), index_(0) {
  const pid_t self = ::gettid();
  rise(self);
  for (; index_ < kMost; ++index_) {
    pid_t none = 0;
    if (threads_.places_[index_].thread.compare_exchange_strong(none, self)) {
      break;
    }
  }
  if (index_ == kMost) {
    return;
  }
  std::size_t before = threads_.used_;
  while (before <= index_ && !threads_.used_.compare_exchange_weak(before, index_ + 1)) {
  }
  AlternateStack stack;
  if (stack) {
    stack.use();
    threads_.places_[index_].handler_stack = stack.release();
  }
}

ChildThreads::Entry::~Entry() {
  if (index_ == kMost) {
    return;
  }
  Place& place = threads_.places_[index_];
  AlternateStack::stop_using();
  // Killed between the two, the thread leaves the stack behind; the other way round another thread
  // else's memory could be given back in its place.
  give_back(place.handler_stack.exchange(nullptr));
  place.thread = 0;
}

void ChildThreads::rest() noexcept {
  const pid_t self = ::gettid();
  const std::size_t end = used_;
  for (std::size_t i = 0; i < end; ++i) {
    if (places_[i].thread == self) {
      places_[i].resting = reinterpret_cast<std::uintptr_t>(__builtin_thread_pointer());
    }
  }
}

void ChildThreads::give_back(void* handler_stack) noexcept {
  AlternateStack::give_back(handler_stack);
}

}  // namespace play_launch::isolation
