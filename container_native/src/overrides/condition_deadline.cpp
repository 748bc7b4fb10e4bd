// Defines pthread_cond_timedwait() for the whole program, as condition_guard.cpp does with
// pthread_cond_destroy().
//
// Where std::condition_variable waits by the steady clock without limit (time_point::max()),
// libstdc++ without pthread_cond_clockwait(), which libraries for old systems are built with, as
// the ROS wheels are, adds the difference of two clocks to it. The sum overflows: a deadline long
// before 1970. The wait returns at once, finds that the time has not come, and waits again. Fast
// DDS does so when a participant goes while a discovery callback runs
// (DomainParticipantImpl::set_listener() of version 2.14), and it keeps the mutex from the very
// thread that it waits for: containers that were stopped during discovery took a processor for a
// second or more.
//
// Such a deadline passes here 10 ms after the call: late, as POSIX allows, so that others get the
// mutex. The awaited thread ends the wait sooner.

#include <pthread.h>

#include <ctime>

#include "base/next_function.hpp"

namespace {

constexpr long kPause = 10'000'000;  // ns
constexpr long kSecond = 1'000'000'000;

const auto next_timedwait =
    play_launch::next_function<"pthread_cond_timedwait">(&pthread_cond_timedwait);

timespec after_pause(clockid_t clock) noexcept {
  timespec time{};
  ::clock_gettime(clock, &time);
  time.tv_nsec += kPause;
  if (time.tv_nsec >= kSecond) {
    time.tv_nsec -= kSecond;
    ++time.tv_sec;
  }
  return time;
}

}  // namespace

extern "C" [[gnu::visibility("default")]] int pthread_cond_timedwait(pthread_cond_t* condition,
                                                                     pthread_mutex_t* mutex,
                                                                     const timespec* deadline) {
  if (deadline->tv_sec >= 0) {
    return next_timedwait.get()(condition, mutex, deadline);
  }
  // Names its clock, as the variable's own is not known here.
  const timespec time = after_pause(CLOCK_MONOTONIC);
  return ::pthread_cond_clockwait(condition, mutex, CLOCK_MONOTONIC, &time);
}
