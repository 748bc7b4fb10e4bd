#include "rcl_stand_in.hpp"

#include <unistd.h>

#include <cstdlib>

#include "busy.hpp"

namespace stand_in {
namespace {

std::mutex lock;

}  // namespace

std::mutex& shared_lock() { return lock; }

void publish() {
  const std::lock_guard guard(lock);
  busy(10'000);
}

void spin_once(void (*callback)()) { callback(); }

void stay_inside(const std::function<void()>& report) {
  const std::lock_guard guard(lock);
  report();
  busy_for_ever();
}

int close_file(int fd) {
  const int result = ::close(fd);
  busy(1);  // the call is not the last of the function
  return result;
}

void crash() {
  const std::lock_guard guard(lock);
  std::abort();
}

}  // namespace stand_in
