// What a child finds of the lives before it on its donor, and limits on its own.

#include <pthread.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <thread>

#include "harness.hpp"
#include "isolation/clone/donor_thread.hpp"

namespace {

using namespace isolation_test;

/// thread_local objects belong to one life: neither destroyed in the container, however the life
/// ended, nor found half-way by the next node.
void test_thread_local_objects() {
  static std::atomic<int> destroyed_in_container{0};
  static const pid_t container = ::getpid();
  struct Local {
    ~Local() { destroyed_in_container += ::getpid() == container ? 1 : 0; }
    int uses = 0;
  };
  for (const bool crashes : {true, true, false, false}) {
    Outcome outcome;
    run(outcome, [crashes](Program&) {
      thread_local Local local;
      CHECK(++local.uses == 1);
      if (crashes) {
        std::abort();
      }
      return 0;
    });
    CHECK(outcome.end.signal == (crashes ? SIGABRT : 0));
  }
  CHECK(destroyed_in_container == 0);
}

/// The stack of a dead thread that was joined becomes another one's, which finds nothing of it.
void test_thread_on_the_stack_of_a_dead_one() {
  static pthread_key_t key{};
  static pthread_t dead{};
  CHECK(::pthread_key_create(&key, nullptr) == 0);
  Program dying([](Program&) {
    const auto allocate_and_die = [](void*) -> void* {
      ::pthread_setspecific(key, &key);
      void* volatile memory = std::malloc(1);
      std::free(memory);
      std::abort();
    };
    CHECK(::pthread_create(&dead, nullptr, allocate_and_die, nullptr) == 0);
    while (true) {
      ::pause();
    }
    return 0;
  });
  Program next([](Program&) {
    CHECK(::pthread_tryjoin_np(dead, nullptr) == 0);
    pthread_t thread{};
    void* found = &thread;
    const auto look = [](void*) { return ::pthread_getspecific(key); };
    CHECK(::pthread_create(&thread, nullptr, look, nullptr) == 0);
    CHECK(thread == dead);
    CHECK(::pthread_join(thread, &found) == 0);
    CHECK(found == nullptr);
    return 0;
  });
  CrashSlot slot;
  ChildEnd death;
  ChildEnd end;
  DonorThread donor("donor", [&] {
    death = run_in_child(dying, slot);
    CHECK(slot.report.resting_thread_count == 1);
    CHECK(give_back_heaps(slot));
    CrashSlot next_slot;
    end = run_in_child(next, next_slot);
  });
  donor.join();
  CHECK(death.signal == SIGABRT);
  CHECK(end.clean());
  ::pthread_key_delete(key);
}

/// What a child may use is time of the processor, so that waiting for one costs it nothing.
void test_limit_of_cpu_time() {
  constexpr std::chrono::milliseconds kLimit{50};
  ChildOptions options;
  options.cpu_limit = kLimit;
  Outcome busy;
  run(
      busy,
      [](Program&) -> int {
        std::thread([] {
          while (true) {
            asm volatile("");
          }
        }).join();
        return 0;
      },
      options);
  CHECK(busy.end.signal == SIGXCPU);
  CHECK(contains(busy.text(), "limit of processor time"));
  Outcome waiting;
  run(
      waiting,
      [&](Program&) {
        std::this_thread::sleep_for(4 * kLimit);
        return 0;
      },
      options);
  CHECK(waiting.end.clean());
}

void test_limits_of_the_kernel() {
  Outcome outcome;
  run(outcome, [](Program&) {
    const rlimit limit{1, 2};
    ::setrlimit(RLIMIT_CPU, &limit);
    while (true) {
    }
    return 0;
  });
  CHECK(outcome.end.signal == SIGXCPU && outcome.slot.report.signal == SIGXCPU);
  CHECK(contains(outcome.text(), "limit of processor time"));
}

void test_limit_of_time() {
  Outcome outcome;
  run(outcome,
      [](Program&) -> int {
        while (true) {
          ::pause();
        }
      },
      {.time_limit = std::chrono::milliseconds(20)});
  CHECK(outcome.end.signal == SIGALRM);
  CHECK(contains(outcome.text(), "limit of time"));
}

/// A child that takes a signal for something of its own keeps it, and what the container ignores,
/// as after nohup, a child ignores.
void test_signals_that_do_not_end_it() {
  static std::atomic<bool> is_handled{false};
  ::signal(SIGHUP, SIG_IGN);
  Outcome outcome;
  Event ready;
  Program program([&](Program& self) {
    ::signal(SIGUSR1, [](int) { is_handled = true; });
    ready.set();
    while (!self.cancelled) {
      std::this_thread::yield();
    }
    return 0;
  });
  DonorThread donor("donor", [&] { outcome.end = run_in_child(program, outcome.slot); });
  ready.wait();
  CHECK(send_signal(outcome.slot, SIGHUP) && send_signal(outcome.slot, SIGUSR1));
  while (!is_handled) {
    std::this_thread::yield();
  }
  program.cancelled = true;
  donor.join();
  ::signal(SIGHUP, SIG_DFL);
  CHECK(outcome.end.clean());
}

/// A joining thread then does not wait for what is still to be released.
void test_the_end_of_a_donor_is_announced() {
  for (const bool crashes : {false, true}) {
    std::atomic<bool> body_is_over{false};
    Event ended;
    Program program([crashes](Program&) {
      if (crashes) {
        std::abort();
      }
      return 0;
    });
    CrashSlot slot;
    DonorThread donor(
        "donor",
        [&] {
          run_in_child(program, slot);
          body_is_over = true;
        },
        [&] {
          CHECK(body_is_over);
          ended.set();
        });
    ended.wait();
    donor.join();
  }
}

}  // namespace

int main() {
  prepare_crash_handling();
  test_thread_local_objects();
  test_thread_on_the_stack_of_a_dead_one();
  test_limit_of_cpu_time();
  test_limits_of_the_kernel();
  test_limit_of_time();
  test_signals_that_do_not_end_it();
  test_the_end_of_a_donor_is_announced();
  return 0;
}
