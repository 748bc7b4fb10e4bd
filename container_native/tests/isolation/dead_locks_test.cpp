// Locks that died with their holders are found, with their waiters; and no others.

#include <signal.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <functional>
#include <mutex>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "harness.hpp"
#include "isolation/after/dead_locks.hpp"

namespace {

using namespace isolation_test;
using namespace std::chrono_literals;

/// A child that runs a body, for as long as that takes.
class Child {
 public:
  explicit Child(std::function<int(Program&)> body, const ChildOptions& options = {})
      : program_([this, body = std::move(body)](Program& self) {
          running_.set();
          return body(self);
        }),
        donor_("donor", [this, options] { end_ = run_in_child(program_, slot_, options); }) {
    running_.wait();
  }

  pid_t pid() const { return slot_.pid; }
  ChildEnd end() {
    donor_.join();
    return end_;
  }
  ChildEnd kill() {
    CHECK(send_signal(slot_, SIGKILL));
    return end();
  }

 private:
  Event running_;
  Program program_;
  CrashSlot slot_;
  ChildEnd end_;
  DonorThread donor_;
};

std::vector<DeadLock> look(DeadLockSearch& search) {
  std::array<DeadLock, 16> found;
  return {found.begin(), found.begin() + search.look(found)};
}

/// Looks until one is found; a thread that is about to wait needs a moment for that.
DeadLock found_one(DeadLockSearch& search) {
  while (true) {
    const std::vector<DeadLock> found = look(search);
    CHECK(found.size() <= 1);
    if (!found.empty()) {
      return found.front();
    }
    std::this_thread::sleep_for(1ms);
  }
}

/// Dies with the lock, in the first thread or another one.
template <class Mutex>
pid_t die_with(Mutex& mutex, bool in_first_thread) {
  const auto hold = [&mutex] {
    mutex.lock();
    ::kill(::getpid(), SIGKILL);
  };
  ChildOptions options;
  options.name = "careless";
  Outcome outcome;
  run(
      outcome,
      [&](Program&) {
        if (in_first_thread) {
          hold();
        } else {
          std::thread(hold).join();
        }
        return 0;
      },
      options);
  CHECK(outcome.end.signal == SIGKILL);
  return outcome.end.pid;
}

void test_dead_holder(DeadLockSearch& search, bool in_first_thread) {
  // Stays locked, and may not be destroyed like that.
  auto& mutex = *new std::mutex();
  const pid_t dead = die_with(mutex, in_first_thread);
  CHECK(look(search).empty());
  Child waiting([&mutex](Program&) {
    mutex.lock();
    return 0;
  });
  const DeadLock found = found_one(search);
  CHECK(found.process == waiting.pid() && found.thread == waiting.pid());
  CHECK(found.holder.process == dead);
  CHECK((found.holder.thread == dead) == in_first_thread);
  CHECK(found.lock >= reinterpret_cast<std::uintptr_t>(&mutex) &&
        found.lock < reinterpret_cast<std::uintptr_t>(&mutex + 1));
  CHECK(contains(describe(found), "held by process " + std::to_string(dead) + " ('careless')"));
  CHECK(found.is_same_wait(found_one(search)));
  waiting.kill();
  CHECK(look(search).empty());
}

void test_a_thread_of_the_container(DeadLockSearch& search) {
  auto& mutex = *new std::mutex();
  die_with(mutex, true);
  std::atomic<pid_t> waiting{0};
  std::thread([&] {
    waiting = ::gettid();
    mutex.lock();
  }).detach();
  const DeadLock found = found_one(search);
  CHECK(found.process == ::getpid() && found.thread == waiting);
  // As if the dead one had given it back.
  mutex.unlock();
  while (!look(search).empty()) {
    std::this_thread::sleep_for(1ms);
  }
}

void test_an_expendable_child_does_not_count(DeadLockSearch& search) {
  auto& mutex = *new std::mutex();
  die_with(mutex, true);
  std::atomic<bool> about_to_wait{false};
  ChildOptions options;
  options.expendable = true;
  Child cleaning(
      [&](Program&) {
        about_to_wait = true;
        mutex.lock();
        return 0;
      },
      options);
  for (int i = 0; i < 50 || !about_to_wait; ++i) {
    CHECK(look(search).empty());
    std::this_thread::sleep_for(1ms);
  }
  cleaning.kill();
}

/// A living holder, a lock that a thread of a living child took away into its own end, a wait with
/// a time limit, and a condition that never comes.
void test_other_waits(DeadLockSearch& search) {
  std::timed_mutex held_by_dead;
  die_with(held_by_dead, true);
  std::mutex held_by_living;
  std::mutex left_locked;
  Event locked;
  Event enough;
  Child living([&](Program&) {
    const std::lock_guard lock(held_by_living);
    std::thread([&] { left_locked.lock(); }).join();
    locked.set();
    enough.wait();
    return 0;
  });
  locked.wait();
  Child waits_for_living([&](Program&) {
    const std::lock_guard lock(held_by_living);
    return 0;
  });
  Child waits_for_left([&](Program&) {
    left_locked.lock();
    return 0;
  });
  Child waits_for_a_while([&](Program&) { return held_by_dead.try_lock_for(1h) ? 1 : 0; });
  for (int i = 0; i < 100; ++i) {
    CHECK(look(search).empty());
    std::this_thread::sleep_for(1ms);
  }
  enough.set();
  CHECK(living.end().clean());
  CHECK(waits_for_living.end().clean());
  waits_for_left.kill();
  waits_for_a_while.kill();
}

}  // namespace

int main() {
  prepare_crash_handling();
  DeadLockSearch search;
  for (const bool in_first_thread : {true, false}) {
    test_dead_holder(search, in_first_thread);
  }
  test_a_thread_of_the_container(search);
  test_an_expendable_child_does_not_count(search);
  test_other_waits(search);
  return 0;
}
