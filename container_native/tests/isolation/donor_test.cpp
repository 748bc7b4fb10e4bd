// Donors come and go: nothing grows with the number of children, however they ended.

#include <dirent.h>
#include <dlfcn.h>
#include <pthread.h>
#include <signal.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <new>
#include <string>
#include <thread>
#include <vector>

#include "harness.hpp"
#include "isolation/clone/inheritance.hpp"

namespace {

using namespace isolation_test;

std::size_t entries(const char* directory) {
  DIR* const listing = ::opendir(directory);
  CHECK(listing != nullptr);
  std::size_t count = 0;
  while (::readdir(listing) != nullptr) {
    ++count;
  }
  ::closedir(listing);
  return count;
}

std::size_t lines(const char* path) {
  std::ifstream file(path);
  std::string line;
  std::size_t count = 0;
  while (std::getline(file, line)) {
    ++count;
  }
  return count;
}

/// From /proc/self/status, in KiB.
std::size_t status(const std::string& key) {
  std::ifstream file("/proc/self/status");
  std::string line;
  while (std::getline(file, line)) {
    if (line.starts_with(key + ":")) {
      return std::stoul(line.substr(key.size() + 1));
    }
  }
  return 0;
}

struct Growth {
  std::size_t files = entries("/proc/self/fd");
  std::size_t threads = entries("/proc/self/task");
  std::size_t mappings = lines("/proc/self/maps");
  std::size_t virtual_kib = status("VmSize");
  std::size_t resident_kib = status("VmRSS");
};

void allocate_and_keep(std::vector<std::unique_ptr<std::string>>& kept) {
  for (int i = 0; i < 200; ++i) {
    kept.push_back(std::make_unique<std::string>(static_cast<std::size_t>(i) * 10, 'x'));
  }
}

/// A node's life: its child allocates and has a thread, then returns or crashes; then another child
/// on the same donor frees what is left.
void live_once(bool crashes) {
  std::vector<std::unique_ptr<std::string>> kept;
  Program living([&](Program&) {
    allocate_and_keep(kept);
    std::thread([&] { allocate_and_keep(kept); }).join();
    if (crashes) {
      std::abort();
    }
    return 0;
  });
  Program burying([&kept](Program&) {
    kept.clear();
    kept.shrink_to_fit();
    return 0;
  });
  CrashSlot slot;
  ChildEnd end;
  ChildEnd burial;
  DonorThread donor("donor", [&] {
    end = run_in_child(living, slot);
    burial = run_in_child(burying, slot);
  });
  donor.join();
  CHECK(end.signal == (crashes ? SIGABRT : 0));
  CHECK(end.returned == !crashes);
  CHECK(burial.clean());
}

void test_growth(bool crashes) {
  constexpr int kWarmUp = 100;
  constexpr int kRounds = 1000;
  for (int i = 0; i < kWarmUp; ++i) {
    live_once(crashes);
    // Looking allocates as well, and mimalloc 3 takes memory in steps of 2 MiB.
    const Growth looked;
    CHECK(looked.threads > 0);
  }
  const Growth before;
  for (int i = 0; i < kRounds; ++i) {
    live_once(crashes);
  }
  const Growth after;
  std::printf(
      "%d %s: files %zu -> %zu, threads %zu -> %zu, mappings %zu -> %zu, virtual memory "
      "%zu -> %zu KiB, resident %zu -> %zu KiB\n",
      kRounds, crashes ? "crashes" : "ends in order", before.files, after.files, before.threads,
      after.threads, before.mappings, after.mappings, before.virtual_kib, after.virtual_kib,
      before.resident_kib, after.resident_kib);
  std::fflush(stdout);
  CHECK(after.files == before.files);
  CHECK(after.threads == before.threads);
  CHECK(after.mappings <= before.mappings + 20);
  // A life as above takes some 500 KiB. The C library's allocator loses what it had cached for the
  // thread; mimalloc loses nothing.
  const bool loses_cache = ::dlsym(RTLD_DEFAULT, "mi_thread_done") == nullptr;
  CHECK(after.resident_kib <= before.resident_kib + (loses_cache ? 250 : 2) * kRounds);
}

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

/// The end of the container ends the children.
void test_children_die_with_their_container() {
  Event alive;
  int ends[2] = {-1, -1};
  CHECK(::pipe(ends) == 0);
  const pid_t container = ::fork();
  CHECK(container >= 0);
  if (container == 0) {
    ::close(ends[0]);
    Outcome outcome;
    run(outcome, [&alive](Program&) -> int {
      alive.set();
      while (true) {
        ::pause();
      }
    });
    ::_exit(0);
  }
  ::close(ends[1]);
  alive.wait();
  CHECK(::kill(container, SIGKILL) == 0);
  // The child holds the other end of the pipe as long as it lives.
  char byte = 0;
  CHECK(::read(ends[0], &byte, 1) == 0);
  ::close(ends[0]);
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
  CHECK(busy.end.signal == SIGKILL);
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
  test_growth(false);
  test_growth(true);
  test_thread_local_objects();
  test_thread_on_the_stack_of_a_dead_one();
  test_children_die_with_their_container();
  test_limit_of_cpu_time();
  test_the_end_of_a_donor_is_announced();
  return 0;
}
