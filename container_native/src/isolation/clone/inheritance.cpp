#include "isolation/clone/inheritance.hpp"

#include <dlfcn.h>
#include <pthread.h>
#include <signal.h>

#include <chrono>
#include <climits>
#include <cstdint>

#include "isolation/clone/vm_clone.hpp"
#include "isolation/record/own_signals.hpp"

#if defined(__x86_64__)
#include <asm/prctl.h>
#include <sys/syscall.h>
#endif

namespace play_launch::isolation {
namespace {

using namespace std::chrono_literals;

constexpr auto kLimit = 200ms;

/// From now on the calling thread finds the thread-local storage of another one, which must be
/// dead, as its own. Not through the C library, which looks up errno there.
[[gnu::always_inline]] inline void become(std::uintptr_t thread_pointer) noexcept {
#if defined(__x86_64__)
  long result = SYS_arch_prctl;
  asm volatile("syscall"
               : "+a"(result)
               : "D"(long{ARCH_SET_FS}), "S"(thread_pointer)
               : "rcx", "r11", "memory");
#elif defined(__aarch64__)
  asm volatile("msr tpidr_el0, %0" : : "r"(thread_pointer) : "memory");
#endif
}

/// What the C library does at the end of a thread, without destructors.
void forget_values_of_keys() noexcept {
  for (pthread_key_t key = 0; key < PTHREAD_KEYS_MAX; ++key) {
    if (::pthread_getspecific(key) != nullptr) {
      ::pthread_setspecific(key, nullptr);
    }
  }
}

[[gnu::noinline]] void end_as(std::uintptr_t thread_pointer, ThreadDone done) noexcept {
  const auto own = reinterpret_cast<std::uintptr_t>(__builtin_thread_pointer());
  become(thread_pointer);
  if (done != nullptr) {
    done();
  }
  forget_values_of_keys();
  become(own);
}

int give_back(void* argument) {
  signal_self_after(kLimit, SIGKILL);
  const auto& slot = *static_cast<const CrashSlot*>(argument);
  const ThreadDone done = allocator_thread_done();
  for (std::uint32_t i = 0; i < slot.report.resting_thread_count; ++i) {
    end_as(slot.report.resting_threads[i], done);
  }
  return 0;
}

}  // namespace

bool give_back_heaps(const CrashSlot& slot) noexcept {
  if (slot.report.resting_thread_count == 0) {
    return true;
  }
  return clone_and_wait(give_back, const_cast<CrashSlot*>(&slot)).clean();
}

namespace {

// Found when the program starts: later, that could wait for the initialisers of a node's library.
const auto function = reinterpret_cast<ThreadDone>(::dlsym(RTLD_DEFAULT, "mi_thread_done"));

}  // namespace

ThreadDone allocator_thread_done() { return function; }

}  // namespace play_launch::isolation
