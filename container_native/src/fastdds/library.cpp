// A library for processes of others that have participants of Fast DDS, see waits.hpp. Preloaded,
// its functions come before the C library's. In a Python that is running already it is too late for
// that: there the entries in the table through which Fast DDS calls them are replaced.

#include "fastdds/waits.hpp"

extern "C" {

[[gnu::visibility("default")]] int pthread_cond_timedwait(pthread_cond_t* condition,
                                                          pthread_mutex_t* mutex,
                                                          const timespec* deadline) {
  return play_launch::fastdds::timedwait(condition, mutex, deadline);
}

[[gnu::visibility("default")]] int pthread_mutex_timedlock(pthread_mutex_t* mutex,
                                                           const timespec* deadline) noexcept {
  return play_launch::fastdds::timedlock(mutex, deadline);
}

[[gnu::visibility("default")]] int pthread_mutex_unlock(pthread_mutex_t* mutex) noexcept {
  return play_launch::fastdds::unlock(mutex);
}

[[gnu::visibility("default")]] int play_launch_replace_waits(const char* prefix) {
  return play_launch::fastdds::replace_waits(prefix);
}

[[gnu::visibility("default")]] void play_launch_withhold_datagrams(int enabled) {
  play_launch::fastdds::withhold_datagrams(enabled != 0);
}

}  // extern "C"
