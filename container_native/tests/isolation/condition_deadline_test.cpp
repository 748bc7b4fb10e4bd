// A deadline before 1970, the overflow of "no limit", must not become a loop.

#include <pthread.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <ctime>
#include <thread>

#include "check.hpp"

namespace {

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
    CHECK(::pthread_cond_timedwait(&condition.variable, &condition.mutex, &overflow) == ETIMEDOUT);
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
    CHECK(::pthread_cond_timedwait(&condition.variable, &condition.mutex, deadline) == ETIMEDOUT);
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
      const int result = ::pthread_cond_timedwait(&condition.variable, &condition.mutex, &deadline);
      CHECK(result == 0 || (result == ETIMEDOUT && deadline.tv_sec < 0));
    }
    ::pthread_mutex_unlock(&condition.mutex);
    notifier.join();
  }
}

}  // namespace

int main() {
  for (const clockid_t clock : {CLOCK_REALTIME, CLOCK_MONOTONIC}) {
    it_pauses_before_it_times_out(clock);
    a_deadline_that_has_passed_times_out(clock);
    a_notification_ends_it(clock);
  }
  return 0;
}
