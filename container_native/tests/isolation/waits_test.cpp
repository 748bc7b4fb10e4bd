// A deadline before 1970, the overflow of "no limit", must not become a loop. And a thread that
// asks again for a mutex between processes that it holds must not wait for itself.

#include "fastdds/waits.hpp"

#include <pthread.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <ctime>
#include <new>
#include <thread>

#include "check.hpp"

namespace {

namespace fastdds = play_launch::fastdds;
using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

struct Condition {
  explicit Condition(clockid_t clock) {
    pthread_condattr_t attributes;
    ::pthread_condattr_init(&attributes);
    ::pthread_condattr_setclock(&attributes, clock);
    ::pthread_cond_init(&variable, &attributes);
    ::pthread_condattr_destroy(&attributes);
  }
  ~Condition() { ::pthread_cond_destroy(&variable); }
  Condition(const Condition&) = delete;
  Condition& operator=(const Condition&) = delete;

  pthread_cond_t variable{};
  pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
};

timespec in(clockid_t clock, std::chrono::seconds seconds) {
  timespec time{};
  ::clock_gettime(clock, &time);
  time.tv_sec += seconds.count();
  return time;
}

void it_pauses_before_it_times_out(clockid_t clock) {
  constexpr int kRounds = 10;
  Condition condition(clock);
  const timespec overflow{-7'461'234'567, 0};
  const auto began = Clock::now();
  ::pthread_mutex_lock(&condition.mutex);
  for (int i = 0; i < kRounds; ++i) {
    CHECK(fastdds::timedwait(&condition.variable, &condition.mutex, &overflow) == ETIMEDOUT);
  }
  ::pthread_mutex_unlock(&condition.mutex);
  CHECK(Clock::now() - began >= kRounds * 5ms);
}

void a_deadline_that_has_passed_times_out(clockid_t clock) {
  Condition condition(clock);
  const timespec passed = in(clock, -1s);
  const timespec epoch{0, 0};
  ::pthread_mutex_lock(&condition.mutex);
  for (const timespec* deadline : {&passed, &epoch}) {
    CHECK(fastdds::timedwait(&condition.variable, &condition.mutex, deadline) == ETIMEDOUT);
  }
  ::pthread_mutex_unlock(&condition.mutex);
}

/// Notified in time, it does not time out; a loop that waits without limit ends.
void a_notification_ends_it(clockid_t clock) {
  Condition condition(clock);
  const std::array<timespec, 2> deadlines{in(clock, 3600s), {-7'461'234'567, 0}};
  for (const timespec& deadline : deadlines) {
    bool is_over = false;
    ::pthread_mutex_lock(&condition.mutex);
    std::thread notifier([&] {
      ::pthread_mutex_lock(&condition.mutex);
      is_over = true;
      ::pthread_mutex_unlock(&condition.mutex);
      ::pthread_cond_signal(&condition.variable);
    });
    while (!is_over) {
      const int result = fastdds::timedwait(&condition.variable, &condition.mutex, &deadline);
      CHECK(result == 0 || (result == ETIMEDOUT && deadline.tv_sec < 0));
    }
    ::pthread_mutex_unlock(&condition.mutex);
    notifier.join();
  }
}

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
    return fastdds::timedlock(&mutex, &deadline);
  }
  int unlock() { return fastdds::unlock(&mutex); }
  /// Whether another thread can take it, and gives it back.
  bool is_free() {
    bool taken = false;
    std::thread([&] {
      taken = ::pthread_mutex_trylock(&mutex) == 0;
      if (taken) {
        fastdds::unlock(&mutex);
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
  for (const clockid_t clock : {CLOCK_REALTIME, CLOCK_MONOTONIC}) {
    it_pauses_before_it_times_out(clock);
    a_deadline_that_has_passed_times_out(clock);
    a_notification_ends_it(clock);
  }
  it_is_got_again_and_given_back_once(PTHREAD_MUTEX_DEFAULT);
  it_is_got_again_and_given_back_once(PTHREAD_MUTEX_NORMAL);
  another_one_between_does_not_matter();
  who_does_not_hold_it_waits();
  others_are_as_always();
  return 0;
}
