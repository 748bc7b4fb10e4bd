// A thread that asks again for a mutex between processes that it holds must not wait for itself.

#include <pthread.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <ctime>
#include <new>
#include <thread>

#include "check.hpp"

namespace {

struct Mutex {
  Mutex(int type, int sharing) {
    pthread_mutexattr_t attributes;
    ::pthread_mutexattr_init(&attributes);
    ::pthread_mutexattr_settype(&attributes, type);
    ::pthread_mutexattr_setpshared(&attributes, sharing);
    ::pthread_mutex_init(&mutex, &attributes);
    ::pthread_mutexattr_destroy(&attributes);
  }
  ~Mutex() { ::pthread_mutex_destroy(&mutex); }
  Mutex(const Mutex&) = delete;
  Mutex& operator=(const Mutex&) = delete;

  int lock(long milliseconds = 3'600'000) {
    timespec deadline{};
    ::clock_gettime(CLOCK_REALTIME, &deadline);
    deadline.tv_sec += milliseconds / 1000;
    deadline.tv_nsec += milliseconds % 1000 * 1'000'000;
    if (deadline.tv_nsec >= 1'000'000'000) {
      ++deadline.tv_sec;
      deadline.tv_nsec -= 1'000'000'000;
    }
    return ::pthread_mutex_timedlock(&mutex, &deadline);
  }
  int unlock() { return ::pthread_mutex_unlock(&mutex); }
  /// Whether another thread can take it, and gives it back.
  bool is_free() {
    bool taken = false;
    std::thread([&] {
      taken = ::pthread_mutex_trylock(&mutex) == 0;
      if (taken) {
        ::pthread_mutex_unlock(&mutex);
      }
    }).join();
    return taken;
  }

  pthread_mutex_t mutex{};
};

void it_is_got_again_and_given_back_once(int type) {
  Mutex one(type, PTHREAD_PROCESS_SHARED);
  for (int round = 0; round < 3; ++round) {
    CHECK(one.lock() == 0 && one.lock() == 0 && one.lock() == 0);
    CHECK(one.unlock() == 0 && !one.is_free());
    CHECK(one.unlock() == 0 && !one.is_free());
    CHECK(one.unlock() == 0 && one.is_free());
  }
}

void another_one_between_does_not_matter() {
  Mutex one(PTHREAD_MUTEX_NORMAL, PTHREAD_PROCESS_SHARED);
  Mutex other(PTHREAD_MUTEX_NORMAL, PTHREAD_PROCESS_SHARED);
  CHECK(one.lock() == 0 && other.lock() == 0);
  CHECK(other.unlock() == 0 && other.is_free());
  CHECK(!one.is_free() && one.unlock() == 0 && one.is_free());
}

void who_does_not_hold_it_waits() {
  Mutex one(PTHREAD_MUTEX_NORMAL, PTHREAD_PROCESS_SHARED);
  CHECK(one.lock() == 0);
  std::thread([&] { CHECK(one.lock(1) == ETIMEDOUT); }).join();
  CHECK(one.unlock() == 0);
  // This thread had it last, but now another process has it.
  void* const memory =
      ::mmap(nullptr, sizeof(Mutex), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  CHECK(memory != MAP_FAILED);
  auto* const shared = new (memory) Mutex(PTHREAD_MUTEX_NORMAL, PTHREAD_PROCESS_SHARED);
  CHECK(shared->lock() == 0);
  const pid_t child = ::fork();
  if (child == 0) {
    // The thread of the child has the entry of its parent, but is not the owner.
    ::_exit(shared->lock(1) == ETIMEDOUT ? 0 : 1);
  }
  int status = -1;
  CHECK(::waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 0);
  CHECK(shared->unlock() == 0);
}

/// All but plain ones between processes are the C library's business alone.
void others_are_as_always() {
  Mutex recursive(PTHREAD_MUTEX_RECURSIVE, PTHREAD_PROCESS_SHARED);
  CHECK(recursive.lock() == 0 && recursive.lock() == 0);
  CHECK(recursive.unlock() == 0 && !recursive.is_free() && recursive.unlock() == 0);
  Mutex checked(PTHREAD_MUTEX_ERRORCHECK, PTHREAD_PROCESS_SHARED);
  CHECK(checked.lock() == 0 && checked.lock() == EDEADLK && checked.unlock() == 0);
  CHECK(checked.unlock() == EPERM);
  Mutex of_one_process(PTHREAD_MUTEX_NORMAL, PTHREAD_PROCESS_PRIVATE);
  CHECK(of_one_process.lock() == 0 && of_one_process.lock(1) == ETIMEDOUT);
  CHECK(of_one_process.unlock() == 0 && of_one_process.is_free());
}

}  // namespace

int main() {
  it_is_got_again_and_given_back_once(PTHREAD_MUTEX_DEFAULT);
  it_is_got_again_and_given_back_once(PTHREAD_MUTEX_NORMAL);
  another_one_between_does_not_matter();
  who_does_not_hold_it_waits();
  others_are_as_always();
  return 0;
}
