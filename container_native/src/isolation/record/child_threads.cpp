#include "isolation/record/child_threads.hpp"

#include <unistd.h>

#include "isolation/record/alternate_stack.hpp"
#include "isolation/record/graveyard.hpp"

namespace play_launch::isolation {

ChildThreads::Entry::Entry(ChildThreads& threads) noexcept : threads_(threads), index_(0) {
  const pid_t self = ::gettid();
  rise(self);
  for (; index_ < kMost; ++index_) {
    pid_t nobody = 0;
    if (threads_.places_[index_].thread.compare_exchange_strong(nobody, self)) {
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
  // Killed between the two, the thread leaves the stack behind; the other way round somebody
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
