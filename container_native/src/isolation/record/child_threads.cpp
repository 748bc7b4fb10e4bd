#include "isolation/record/child_threads.hpp"

#include <cxxabi.h>
#include <linux/futex.h>
#include <pthread.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <climits>
#include <cstddef>
#include <cstdint>
#include <utility>

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
  forget_dead_thread(self);
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

namespace {

// The kernel alone stores up to 11 KiB of vector registers; the unwinder needs a few more.
constexpr std::size_t kSize = 128 * 1024;
constexpr std::size_t kGuard = 64 * 1024;  // the largest page

void* bottom_of(void* mapping) { return static_cast<char*>(mapping) + kGuard; }

}  // namespace

AlternateStack::AlternateStack() noexcept {
  void* const mapping = ::mmap(nullptr, kGuard + kSize, PROT_NONE,
                               MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (mapping == MAP_FAILED) {
    return;
  }
  if (::mprotect(bottom_of(mapping), kSize, PROT_READ | PROT_WRITE) != 0) {
    give_back(mapping);
    return;
  }
  mapping_ = mapping;
}

AlternateStack::~AlternateStack() { give_back(mapping_); }

void AlternateStack::use() const noexcept {
  stack_t stack{};
  stack.ss_sp = bottom_of(mapping_);
  stack.ss_size = kSize;
  ::sigaltstack(&stack, nullptr);
}

void AlternateStack::stop_using() noexcept {
  stack_t stack{};
  stack.ss_flags = SS_DISABLE;
  ::sigaltstack(&stack, nullptr);
}

void* AlternateStack::release() noexcept { return std::exchange(mapping_, nullptr); }

void AlternateStack::give_back(void* released) noexcept {
  if (released != nullptr) {
    ::munmap(released, kGuard + kSize);
  }
}

namespace {

constexpr std::size_t kMostDeadThreads = 4096;

// Written by donors and threads of children, which may be killed amidst it: no locks.
struct Place {
  std::atomic<pid_t> thread{0};
  std::atomic<pid_t> process{0};
  std::array<std::atomic<std::uint64_t>, 2> name{};
};

std::array<Place, kMostDeadThreads> places;
std::atomic<std::size_t> noted{0};

std::size_t noted_now() { return std::min<std::size_t>(noted, kMostDeadThreads); }

}  // namespace

void note_dead_thread(pid_t thread, pid_t process, std::string_view process_name) noexcept {
  std::array<char, 16> name{};
  std::copy_n(process_name.data(), std::min(process_name.size(), name.size() - 1), name.data());
  const auto words = std::bit_cast<std::array<std::uint64_t, 2>>(name);
  Place& place = places[noted.fetch_add(1) % kMostDeadThreads];
  place.thread = 0;
  place.process = process;
  place.name[0] = words[0];
  place.name[1] = words[1];
  place.thread = thread;
}

void forget_dead_thread(pid_t thread) noexcept {
  const std::size_t end = noted_now();
  for (std::size_t i = 0; i < end; ++i) {
    pid_t expected = thread;
    // Each thread of a node looks when it begins; hardly one of them is in the list.
    if (places[i].thread.load(std::memory_order_relaxed) == thread) {
      places[i].thread.compare_exchange_strong(expected, 0);
    }
  }
}

std::optional<DeadThread> find_dead_thread(pid_t thread) noexcept {
  const std::size_t end = noted_now();
  for (std::size_t i = 0; i < end; ++i) {
    const Place& place = places[i];
    if (place.thread != thread) {
      continue;
    }
    DeadThread dead{thread, place.process, {}};
    dead.process_name = std::bit_cast<std::array<char, 16>>(
        std::array<std::uint64_t, 2>{place.name[0], place.name[1]});
    if (place.thread == thread) {
      return dead;
    }
  }
  return std::nullopt;
}

}  // namespace play_launch::isolation
