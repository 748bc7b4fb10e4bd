#pragma once

#include <sys/types.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace play_launch::isolation {

/// The threads that a child has besides its first one, as far as they were started with
/// pthread_create(), which thread_guard.cpp defines for the whole program: it gives each of them a
/// stack for crash handlers and an entry here. Async-signal-safe.
class ChildThreads {
 public:
  /// More of them are not listed, and cannot report that their stack overflowed.
  static constexpr std::size_t kMost = 512;

  /// The calling thread's entry, with its stack for handlers, while it exists.
  class Entry {
   public:
    explicit Entry(ChildThreads& threads) noexcept;
    ~Entry();
    Entry(const Entry&) = delete;
    Entry& operator=(const Entry&) = delete;

   private:
    ChildThreads& threads_;
    std::size_t index_;
  };

  /// The calling thread stops here for good, and not amidst anything that it shares with others:
  /// what the allocator keeps for it can be given back when it is dead.
  void rest() noexcept;

  /// When no thread of the child is left: gives back their stacks, and calls visit(thread, pointer)
  /// for each that was killed instead of ending by itself; `pointer` is its thread pointer if it
  /// was at rest, else 0.
  template <class Visit>
  void bury(Visit visit) noexcept {
    const std::size_t end = used_;
    for (std::size_t i = 0; i < end; ++i) {
      if (const pid_t thread = places_[i].thread.exchange(0)) {
        visit(thread, places_[i].resting.exchange(0));
      }
      give_back(places_[i].handler_stack.exchange(nullptr));
    }
  }

 private:
  struct Place {
    std::atomic<pid_t> thread{0};
    std::atomic<void*> handler_stack{nullptr};
    std::atomic<std::uintptr_t> resting{0};
  };

  static void give_back(void* handler_stack) noexcept;

  std::array<Place, kMost> places_{};
  /// Places from here on were never taken.
  std::atomic<std::size_t> used_{0};
};

}  // namespace play_launch::isolation
