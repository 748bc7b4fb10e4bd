#include "hosts/shared/task_group.hpp"

#include <pthread.h>

#include <utility>

namespace play_launch::container {

TaskGroup::~TaskGroup() {
  std::unique_lock lock(mutex_);
  while (!running_.empty() || finished_.joinable()) {
    std::thread next;
    if (finished_.joinable()) {
      next = std::move(finished_);
    } else {
      auto first = running_.begin();
      next = std::move(first->second);
      running_.erase(first);
    }
    lock.unlock();
    next.join();
    lock.lock();
  }
}

void TaskGroup::run(const std::string& name, std::function<void()> task) {
  // The lock is held until the thread is in the map, so that it cannot finish before that.
  const std::lock_guard lock(mutex_);
  const std::uint64_t number = ++last_number_;
  std::thread thread([this, number, name, task = std::move(task)]() mutable {
    ::pthread_setname_np(::pthread_self(), name.c_str());
    task();
    task = nullptr;  // what it holds is freed in this thread, before it counts as done
    finish(number);
  });
  running_.emplace(number, std::move(thread));
}

void TaskGroup::finish(std::uint64_t number) {
  std::thread before;
  {
    const std::lock_guard lock(mutex_);
    auto self = running_.find(number);
    if (self == running_.end()) {
      return;  // the destructor joins this thread
    }
    before = std::exchange(finished_, std::move(self->second));
    running_.erase(self);
  }
  if (before.joinable()) {
    before.join();
  }
}

}  // namespace play_launch::container
