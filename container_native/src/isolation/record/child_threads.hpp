#pragma once

#include <sys/types.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

namespace play_launch::isolation {

/// What threads of a child are initialising for all that share the memory: function-local static
/// variables, and what pthread_once() is for. Others wait for the end, which does not come when the
/// child dies. thread_guard.cpp notes them. Async-signal-safe.
class Initialisations {
 public:
  /// More of them at a time are not noted.
  static constexpr std::size_t kMost = 64;

  enum class Kind : std::uintptr_t { guard, once };

  // Merged into the function that notes it, in which quiescing leaves no thread.
  [[gnu::always_inline]] inline void begin(const void* control, Kind kind) noexcept {
    const std::uintptr_t begun = value(control, kind);
    for (auto& place : begun_) {
      std::uintptr_t none = 0;
      if (place.compare_exchange_strong(none, begun)) {
        return;
      }
    }
  }
  [[gnu::always_inline]] inline void end(const void* control, Kind kind) noexcept {
    for (auto& place : begun_) {
      std::uintptr_t begun = value(control, kind);
      if (place.compare_exchange_strong(begun, 0)) {
        return;
      }
    }
  }

  /// When no thread of the child is left: as if each had ended with an exception. The next to come,
  /// or one that waits, begins anew.
  void undo() noexcept;

 private:
  /// Both kinds of controls are aligned.
  static std::uintptr_t value(const void* control, Kind kind) noexcept {
    return reinterpret_cast<std::uintptr_t>(control) | static_cast<std::uintptr_t>(kind);
  }

  std::array<std::atomic<std::uintptr_t>, kMost> begun_{};
};

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
  /// for each that was killed instead of returning; `pointer` is its thread pointer if it
  /// was at rest, else 0.
  template <class Visit>
  void clean_up(Visit visit) noexcept {
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

/// Where crash handlers run, also when the stack has overflowed: memory with a page below it that
/// faults. Async-signal-safe.
class AlternateStack {
 public:
  /// False when there is no memory to be had.
  AlternateStack() noexcept;
  ~AlternateStack();
  AlternateStack(const AlternateStack&) = delete;
  AlternateStack& operator=(const AlternateStack&) = delete;

  explicit operator bool() const { return mapping_ != nullptr; }

  /// Makes it the calling thread's.
  void use() const noexcept;
  /// The calling thread has none any more.
  static void stop_using() noexcept;

  /// Leaves it to another thread, which calls give_back().
  void* release() noexcept;
  static void give_back(void* released) noexcept;

 private:
  void* mapping_ = nullptr;
};

/// A thread of a child that was killed, or died, without coming to its end.
struct DeadThread {
  pid_t thread = 0;
  pid_t process = 0;
  std::array<char, 16> process_name{};
};

/// Remembers such a thread; only the last 4096 are known. Any thread; async-signal-safe, as are the
/// others.
void note_dead_thread(pid_t thread, pid_t process, std::string_view process_name) noexcept;

/// The id belongs to a living thread again.
void forget_dead_thread(pid_t thread) noexcept;

/// The node of that process, if it is among the dead.
std::optional<DeadThread> find_dead_thread(pid_t thread) noexcept;

}  // namespace play_launch::isolation
