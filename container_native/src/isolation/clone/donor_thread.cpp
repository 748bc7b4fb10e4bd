#include "isolation/clone/donor_thread.hpp"

#include <dlfcn.h>
#include <pthread.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <climits>
#include <cstdint>
#include <system_error>
#include <utility>

#include "isolation/clone/vm_clone.hpp"
#include "isolation/record/own_signals.hpp"

#if defined(__x86_64__)
#include <asm/prctl.h>
#endif

namespace play_launch::isolation {
namespace {

using namespace std::chrono_literals;

/// mimalloc's function that leaves the calling thread's memory to the surviving threads; null with
/// another allocator. Async-signal-safe.
using ThreadDone = void (*)();

constexpr std::size_t kGuardSize = 64 * 1024;  // the largest page
constexpr auto kGiveBackLimit = 200ms;

[[noreturn]] void fail(int error, const char* what) {
  throw std::system_error(error, std::generic_category(), what);
}

std::size_t default_stack_size() {
  pthread_attr_t attributes;
  std::size_t size = 0;
  if (const int error = ::pthread_getattr_default_np(&attributes)) {
    fail(error, "pthread_getattr_default_np");
  }
  ::pthread_attr_getstacksize(&attributes, &size);
  ::pthread_attr_destroy(&attributes);
  return size;
}

// Found when the program starts: later, that could wait for the initialisers of a node's library.
const auto thread_done = reinterpret_cast<ThreadDone>(::dlsym(RTLD_DEFAULT, "mi_thread_done"));

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

int give_back_of_resting(void* argument) {
  signal_self_after(kGiveBackLimit, SIGKILL);
  const auto& slot = *static_cast<const CrashSlot*>(argument);
  for (std::uint32_t i = 0; i < slot.report.resting_thread_count; ++i) {
    end_as(slot.report.resting_threads[i], thread_done);
  }
  return 0;
}

/// Runs in a child: the allocator's lists for this thread may be broken, or end in themselves.
int give_back_memory(void*) {
  signal_self_after(kGiveBackLimit, SIGKILL);
  thread_done();
  return 0;
}

}  // namespace

DonorThread::DonorThread(const std::string& name, std::function<void()> body,
                         std::function<void()> ended)
    : body_(std::move(body)), ended_(std::move(ended)), name_(name.substr(0, 15)) {
  prepare_clone();
  // A stack of our own, because it also holds the thread's record in the C library: that of a
  // tainted thread must not be used for another one.
  mapping_size_ = kGuardSize + (default_stack_size() + kGuardSize - 1) / kGuardSize * kGuardSize;
  mapping_ = ::mmap(nullptr, mapping_size_, PROT_NONE,
                    MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE | MAP_STACK, -1, 0);
  if (mapping_ == MAP_FAILED) {
    fail(errno, "mmap of a thread's stack");
  }
  char* const bottom = static_cast<char*>(mapping_) + kGuardSize;
  const std::size_t size = mapping_size_ - kGuardSize;
  int error = ::mprotect(bottom, size, PROT_READ | PROT_WRITE) == 0 ? 0 : errno;
  if (error == 0) {
    pthread_attr_t attributes;
    ::pthread_attr_init(&attributes);
    ::pthread_attr_setstack(&attributes, bottom, size);
    error = ::pthread_create(&thread_, &attributes, &DonorThread::start, this);
    ::pthread_attr_destroy(&attributes);
  }
  if (error != 0) {
    ::munmap(mapping_, mapping_size_);
    fail(error, "starting a thread");
  }
  joinable_ = true;
}

DonorThread::~DonorThread() { join(); }

void DonorThread::join() {
  if (joinable_) {
    joinable_ = false;
    ::pthread_join(thread_, nullptr);
    ::munmap(mapping_, mapping_size_);
  }
}

void* DonorThread::start(void* self) {
  auto& donor = *static_cast<DonorThread*>(self);
  ::pthread_setname_np(::pthread_self(), donor.name_.c_str());
  donor.rank_.begin();
  // Should a child manage to cancel the thread, it must not be the donor that ends.
  ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, nullptr);
  donor.body_();
  donor.rank_.end();
  if (thread_done != nullptr) {
    clone_and_wait(give_back_memory, nullptr);
  }
  if (donor.ended_) {
    donor.ended_();
  }
  // Past the C library's end of a thread: it would run destructors of thread-local objects that are
  // the child's. The kernel wakes join().
  ::syscall(SYS_exit, 0);
  __builtin_unreachable();
}

bool give_back_heaps(const CrashSlot& slot) noexcept {
  if (slot.report.resting_thread_count == 0) {
    return true;
  }
  return clone_and_wait(give_back_of_resting, const_cast<CrashSlot*>(&slot)).clean();
}

}  // namespace play_launch::isolation
