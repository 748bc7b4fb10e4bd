// Defines pthread_mutex_timedlock() and pthread_mutex_unlock() for the whole program, as
// condition_guard.cpp does with pthread_cond_destroy().
//
// Where the reader of a queue in shared memory dies, or looks dead, in the midst of a message, each
// of its writers looks for what it was reading, under the queue's mutex, and takes the same mutex
// once more to note that it has found it
// (SharedMemGlobal::Port::get_and_remove_blocked_processing() of Fast DDS, in version 2.14 and
// since). That waits for itself, for the second that Fast DDS gives each lock, then the note is
// missing, it finds the same again, without end: the process goes on publishing nothing, and
// a process that shares the queue waits a second for each of its locks.
//
// Here a thread that asks, with a deadline, for a mutex between processes that it has already gets
// it again, and the first of the two unlocks fails.

#include <pthread.h>
#include <unistd.h>

#include <ctime>

#include "base/next_function.hpp"

namespace {

const auto next_unlock = play_launch::next_function<"pthread_mutex_unlock">(&pthread_mutex_unlock);

// The kind of a mutex in the C library (nptl/pthreadP.h): PTHREAD_MUTEX_PSHARED_BIT, with 0 for the
// type of one that is neither recursive nor checked, robust or with priorities. Above is elision.
constexpr int kKinds = 0xff;
constexpr int kShared = 0x80;

/// The last mutex between processes that this thread has taken here, and how often besides. A
/// thread that died with it may have left it to the next one on its stack, so it holds only for the
/// owner.
struct Held {
  const pthread_mutex_t* mutex = nullptr;
  unsigned again = 0;
};
constinit thread_local Held held;

}  // namespace

extern "C" {

[[gnu::visibility("default")]] int pthread_mutex_timedlock(pthread_mutex_t* mutex,
                                                           const timespec* deadline) noexcept {
  if (held.mutex == mutex && mutex->__data.__owner == ::gettid()) {
    ++held.again;
    return 0;
  }
  const int result = ::pthread_mutex_clocklock(mutex, CLOCK_REALTIME, deadline);
  if (result == 0 && (mutex->__data.__kind & kKinds) == kShared) {
    held = {mutex, 0};
  }
  return result;
}

[[gnu::visibility("default")]] int pthread_mutex_unlock(pthread_mutex_t* mutex) noexcept {
  if (held.mutex == mutex) [[unlikely]] {
    if (held.again > 0 && mutex->__data.__owner == ::gettid()) {
      --held.again;
      return 0;
    }
    held = {};
  }
  return next_unlock.get()(mutex);
}

}  // extern "C"
