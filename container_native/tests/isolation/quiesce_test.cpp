// What a crash does to the other threads of its child: they are stopped where they hold nothing
// that outlives them.

#include <dlfcn.h>
#include <signal.h>

#include <array>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <mutex>
#include <new>
#include <shared_mutex>
#include <thread>

#include "busy.hpp"
#include "harness.hpp"
#include "isolation/quiesce/quiesce.hpp"
#include "node_stand_in.hpp"
#include "rcl_stand_in.hpp"

namespace stand_in {

const NodeLibrary& node_library() {
  static void* const library = ::dlopen(NODE_STAND_IN, RTLD_NOW | RTLD_LOCAL);
  CHECK(library != nullptr);
  static const void* const found = ::dlsym(library, "play_launch_test_node");
  CHECK(found != nullptr);
  return *static_cast<const NodeLibrary*>(found);
}

bool locks_are_free() {
  const std::unique_lock first(shared_lock(), std::try_to_lock);
  const std::unique_lock second(node_library().pointer_lock(), std::try_to_lock);
  return first.owns_lock() && second.owns_lock();
}

/// After a thread was killed with one of them.
void renew_locks() {
  new (&shared_lock()) std::mutex;
  new (&node_library().pointer_lock()) std::shared_timed_mutex;
}

}  // namespace stand_in

namespace {

using namespace isolation_test;
using namespace std::chrono_literals;

/// As run(), with a limit so long that it does not matter how busy the machine is.
void run_patiently(Outcome& outcome, std::function<int(Program&)> body) {
  run(outcome, std::move(body), {.quiesce_limit = 10s});
}

/// Crashes in the first thread beside `threads` that do `work` without end.
void crash_beside(Outcome& outcome, int threads, void (*work)()) {
  run_patiently(outcome, [&](Program&) {
    std::atomic<int> running{0};
    for (int i = 0; i < threads; ++i) {
      std::thread([&] {
        ++running;
        work();
      }).detach();
    }
    while (running < threads) {
      std::this_thread::yield();
    }
    std::this_thread::sleep_for(std::chrono::microseconds(std::rand() % 300));
    std::abort();
    return 0;
  });
  CHECK(outcome.end.signal == SIGABRT);
}

void work_in_the_allocator() {
  while (true) {
    for (std::size_t size = 16; size < 100'000; size *= 2) {
      std::free(std::malloc(size));
    }
  }
}

void work_in_the_middleware() {
  while (true) {
    stand_in::publish();
    busy(1000);
  }
}

void wait_in_user_code() {
  static auto* const mutex = new std::mutex;
  static auto* const never = new std::condition_variable;  // destroying it would wait for the dead
  std::unique_lock lock(*mutex);
  never->wait(lock, [] { return false; });
}

void sleep_in_user_code() {
  while (true) {
    std::this_thread::sleep_for(std::chrono::hours(1));
  }
}

struct Case {
  const char* name;
  void (*work)();
  int rounds;
};

constexpr std::array kCases{
    Case{"computes", [] { stand_in::node_library().compute_for_ever(); }, 10},
    Case{"called back by the middleware",
         [] { stand_in::spin_once(stand_in::node_library().compute_for_ever); }, 10},
    Case{"waits", wait_in_user_code, 10},
    Case{"sleeps", sleep_in_user_code, 10},
    Case{"allocates", work_in_the_allocator, 15},
    Case{"publishes", work_in_the_middleware, 15},
    Case{"publishes by pointer", [] { stand_in::node_library().publish_by_pointer_for_ever(); },
         15},
};

void test_case(const Case& subject) {
  constexpr int kThreads = 3;
  for (int round = 0; round < subject.rounds; ++round) {
    Outcome outcome;
    crash_beside(outcome, kThreads, subject.work);
    CHECK(!outcome.slot.report.inside);
    CHECK(outcome.slot.report.threads_parked == kThreads &&
          outcome.slot.report.threads_not_parked == 0);
    CHECK(!contains(outcome.text(), "could not be stopped"));
    CHECK(stand_in::locks_are_free());
    std::free(std::malloc(1000));
  }
  std::printf("%-30s %d threads parked\n", subject.name, subject.rounds * kThreads);
  std::fflush(stdout);
}

/// One that never comes out is left alone, and reported.
void test_thread_that_cannot_be_parked() {
  Outcome outcome;
  Program program([](Program&) {
    std::atomic<bool> inside{false};
    std::thread([&inside] { stand_in::stay_inside([&inside] { inside = true; }); }).detach();
    while (!inside) {
      std::this_thread::yield();
    }
    std::abort();
    return 0;
  });
  run(outcome, program, {.quiesce_limit = 20ms});
  CHECK(outcome.end.signal == SIGABRT);
  CHECK(outcome.slot.report.threads_parked == 0 && outcome.slot.report.threads_not_parked == 1);
  CHECK(contains(outcome.text(), "1 of its threads could not be stopped"));
  CHECK(!stand_in::locks_are_free());
  stand_in::renew_locks();
}

#if defined(__x86_64__)
extern "C" void play_launch_test_call_without_frame(std::atomic<bool>* inside) {
  stay_inside_without_frame(inside);
}

/// Its way out would be written where no memory is.
void test_thread_without_a_frame() {
  Outcome outcome;
  Program program([](Program&) {
    std::atomic<bool> inside{false};
    std::thread(play_launch_test_call_without_frame, &inside).detach();
    while (!inside) {
      std::this_thread::yield();
    }
    std::abort();
    return 0;
  });
  run(outcome, program, {.quiesce_limit = 20ms});
  CHECK(outcome.end.signal == SIGABRT);
  CHECK(outcome.slot.phase == ChildPhase::dying && outcome.slot.report.threads_not_parked == 1);
}
#endif

/// A thread that crashes with a lock of the middleware cannot be helped, but reported.
void test_crash_inside_the_middleware() {
  Outcome outcome;
  run_patiently(outcome, [](Program&) {
    stand_in::crash();
    return 0;
  });
  CHECK(outcome.slot.report.inside);
  CHECK(contains(outcome.text(), "died inside the middleware"));
  CHECK(!stand_in::locks_are_free());
  stand_in::renew_locks();
}

/// The first thread waits for the one that crashes, as a multi-threaded executor's does.
void test_first_thread_joins() {
  Outcome outcome;
  run_patiently(outcome, [](Program&) {
    stand_in::spin_once([] { std::thread([] { std::abort(); }).join(); });
    return 0;
  });
  CHECK(outcome.end.signal == SIGABRT);
  CHECK(outcome.slot.report.threads_parked == 1 && outcome.slot.report.threads_not_parked == 0);
}

/// A thread that comes out of spin() after a crash elsewhere must not begin to destroy things.
void test_cancelled_threads_park() {
  static std::atomic<bool> destroyed{false};
  Outcome outcome;
  run_patiently(outcome, [](Program& program) {
    std::thread crashing([] { std::abort(); });
    while (!program.cancelled) {
      stand_in::publish();
    }
    park_if_dying();
    destroyed = true;
    crashing.join();
    return 0;
  });
  CHECK(outcome.end.signal == SIGABRT);
  CHECK(!destroyed);
  CHECK(outcome.slot.report.threads_parked == 1);
}

void test_several_crash_at_once() {
  for (int round = 0; round < 25; ++round) {
    Outcome outcome;
    run_patiently(outcome, [](Program&) {
      std::atomic<int> ready{0};
      const auto crash = [&ready] {
        ++ready;
        while (ready < 3) {
        }
        std::abort();
      };
      std::thread one(crash);
      std::thread two(crash);
      crash();
      return 0;
    });
    CHECK(outcome.end.signal == SIGABRT);
    CHECK(outcome.slot.report.threads_parked == 2);
  }
}

/// exit() and the end of run() kill threads as well.
void test_other_ends() {
  for (const bool by_exit : {true, false}) {
    for (int round = 0; round < 20; ++round) {
      Outcome outcome;
      run_patiently(outcome, [by_exit](Program&) {
        std::atomic<bool> running{false};
        std::thread([&running] {
          running = true;
          work_in_the_middleware();
        }).detach();
        while (!running) {
          std::this_thread::yield();
        }
        if (by_exit) {
          std::exit(1);
        }
        return 1;
      });
      CHECK(outcome.end.exit_code == 1);
      CHECK(outcome.slot.report.threads_parked == 1 && outcome.slot.report.threads_not_parked == 0);
      CHECK(stand_in::locks_are_free());
    }
  }
}

/// One end beside a thread that blocks all signals, as libraries' helpers do that leave them to
/// others: ZeroMQ's, GLib's. `wait` says that it begins before it does.
void end_beside_deaf(Outcome& outcome, const ChildOptions& options,
                     const std::function<void(std::atomic<bool>&)>& wait) {
  Program program([&wait](Program&) {
    std::atomic<bool> waiting{false};
    std::thread([&] {
      sigset_t all;
      ::sigfillset(&all);
      ::pthread_sigmask(SIG_BLOCK, &all, nullptr);
      wait(waiting);
    }).detach();
    while (!waiting) {
      std::this_thread::yield();
    }
    return 1;
  });
  run(outcome, program, options);
  CHECK(outcome.end.exit_code == 1);
}

void test_threads_that_block_all_signals() {
  const Event never;
  Outcome reading;
  end_beside_deaf(reading, {.quiesce_limit = 10s}, [&](std::atomic<bool>& waiting) {
    waiting = true;
    never.wait();
  });
  CHECK(reading.slot.report.threads_parked == 1 && reading.slot.report.threads_not_parked == 0);
  // What it may hold cannot be seen.
  Outcome computing;
  end_beside_deaf(computing, {.quiesce_limit = 20ms}, [](std::atomic<bool>& waiting) {
    waiting = true;
    busy_for_ever();
  });
  CHECK(computing.slot.report.threads_not_parked == 1);
  Outcome locking;
  end_beside_deaf(locking, {.quiesce_limit = 20ms}, [](std::atomic<bool>& waiting) {
    std::mutex mutex;
    mutex.lock();
    waiting = true;
    mutex.lock();
  });
  CHECK(locking.slot.report.threads_not_parked == 1);
}

/// A node with a thread that waits for work, as its class would be written anywhere.
class Worker {
 public:
  ~Worker() {
    {
      const std::lock_guard lock(mutex_);
      done_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }

  void wait_until_it_waits() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return waits_; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool waits_ = false;
  bool done_ = false;
  std::thread thread_{[this] {
    std::unique_lock lock(mutex_);
    waits_ = true;
    changed_.notify_all();
    changed_.wait(lock, [this] { return done_; });
  }};
};

void test_destroying_what_the_dead_left() {
  static Worker* worker = nullptr;
  Program crashing([](Program&) {
    worker = new Worker;
    worker->wait_until_it_waits();
    std::abort();
    return 0;
  });
  Program cleaning([](Program&) {
    delete worker;
    return 0;
  });
  for (int round = 0; round < 20; ++round) {
    CrashSlot slot;
    ChildEnd crash;
    ChildEnd cleanup;
    DonorThread donor("donor", [&] {
      crash = run_in_child(crashing, slot);
      cleanup = run_in_child(cleaning, slot, {.name = "cleanup", .time_limit = 2s});
    });
    donor.join();
    CHECK(crash.signal == SIGABRT);
    CHECK(cleanup.clean());
  }
}

/// A thread that is ended within abort() holds nothing that another one waits for.
void test_abort_after_one_that_was_cut_off() {
  Outcome cut_off;
  run_patiently(cut_off, [](Program&) {
    sigset_t only;
    ::sigemptyset(&only);
    ::sigaddset(&only, SIGABRT);
    ::pthread_sigmask(SIG_BLOCK, &only, nullptr);
    ::raise(SIGABRT);  // is delivered in abort(), when that unblocks it
    std::abort();
    return 0;
  });
  CHECK(cut_off.end.signal == SIGABRT);
  Outcome next;
  run_patiently(next, [](Program&) {
    std::thread([] { std::abort(); }).join();  // a recursive lock would let the same thread in
    return 0;
  });
  CHECK(next.end.signal == SIGABRT);
}

}  // namespace

int main() {
  prepare_crash_handling();
  stand_in::node_library();
  for (const Case& subject : kCases) {
    test_case(subject);
  }
  test_thread_that_cannot_be_parked();
#if defined(__x86_64__)
  test_thread_without_a_frame();
#endif
  test_crash_inside_the_middleware();
  test_first_thread_joins();
  test_cancelled_threads_park();
  test_several_crash_at_once();
  test_other_ends();
  test_threads_that_block_all_signals();
  test_destroying_what_the_dead_left();
  test_abort_after_one_that_was_cut_off();
  return 0;
}
