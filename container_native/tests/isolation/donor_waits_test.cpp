// How a donor waits for its child: in a sleep that can be interrupted and does not count as load,
// until the child is dead, however that comes, and no longer.

#include <dirent.h>
#include <pthread.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "harness.hpp"
#include "isolation/clone/vm_clone.hpp"

namespace {

using namespace isolation_test;

[[noreturn]] void sleep_for_ever() {
  while (true) {
    ::pause();
  }
}

/// Children that sleep until asked to end, each on a donor of its own.
class Sleepers {
 public:
  explicit Sleepers(std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      sleepers_.push_back(std::make_unique<Sleeper>(awake_));
    }
    for (std::size_t i = 0; i < count; ++i) {
      awake_.wait();
    }
  }
  ~Sleepers() {
    for (const auto& sleeper : sleepers_) {
      CHECK(send_signal(sleeper->slot, SIGKILL));
    }
    for (const auto& sleeper : sleepers_) {
      sleeper->donor.join();
      CHECK(sleeper->end.signal == SIGKILL);
    }
  }
  Sleepers(const Sleepers&) = delete;
  Sleepers& operator=(const Sleepers&) = delete;

 private:
  struct Sleeper {
    explicit Sleeper(const Event& awake)
        : program([&awake](Program&) -> int {
            awake.set();
            sleep_for_ever();
          }) {}

    Program program;
    CrashSlot slot;
    ChildEnd end;
    DonorThread donor{"donor", [this] { end = run_in_child(program, slot); }};
  };

  Event awake_;
  std::vector<std::unique_ptr<Sleeper>> sleepers_;
};

/// The states of a process's threads, as in /proc/<pid>/task/*/stat.
std::string states(pid_t process) {
  const std::string tasks = "/proc/" + std::to_string(process) + "/task/";
  std::string all;
  DIR* const listing = ::opendir(tasks.c_str());
  CHECK(listing != nullptr);
  while (const dirent* const entry = ::readdir(listing)) {
    std::ifstream file(tasks + entry->d_name + "/stat");
    std::string line;
    if (entry->d_name[0] != '.' && std::getline(file, line)) {
      all += line.at(line.rfind(')') + 2);
    }
  }
  ::closedir(listing);
  return all;
}

/// Donors may still be on their way into their sleep, so it is looked at until it is so.
void wait_for_states(pid_t process, const std::string& expected) {
  while (true) {
    std::string seen = states(process);
    std::sort(seen.begin(), seen.end());
    CHECK(seen.find('D') == std::string::npos);
    if (seen == expected) {
      return;
    }
    ::usleep(1000);
  }
}

void test_donors_do_not_count_as_load() {
  constexpr std::size_t kCount = 30;
  const Sleepers sleepers(kCount);
  wait_for_states(::getpid(), "R" + std::string(kCount, 'S'));
}

/// Forks a process with sleeping children. Runs `look` on it, and what the process itself runs when
/// that is done; its status must be 0.
template <class Look, class Run>
void with_container(std::size_t children, Look look, Run run) {
  Event ready;
  Event go_on;
  const pid_t container = ::fork();
  CHECK(container >= 0);
  if (container == 0) {
    {
      const Sleepers sleepers(children);
      ready.set();
      go_on.wait();
      run();
    }
    ::_exit(0);
  }
  ready.wait();
  look(container);
  go_on.set();
  int status = 0;
  CHECK(::waitpid(container, &status, 0) == container);
  CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

void test_the_container_can_be_stopped_and_goes_on() {
  constexpr std::size_t kCount = 10;
  with_container(
      kCount,
      [](pid_t container) {
        for (int i = 0; i < 50; ++i) {
          CHECK(::kill(container, SIGSTOP) == 0);
          int status = 0;
          // Reported when every thread has stopped: with one in state D, never.
          CHECK(::waitpid(container, &status, WUNTRACED) == container && WIFSTOPPED(status));
          CHECK(states(container) == std::string(kCount + 1, 'T'));
          CHECK(::kill(container, SIGCONT) == 0);
        }
        wait_for_states(container, std::string(kCount + 1, 'S'));
      },
      [] {});
}

struct Death {
  const char* name;
  int exit_code;
  int signal;
  bool returned;
  std::function<int(const Event& alive)> way;
  bool from_outside;
};

void fault() { *reinterpret_cast<volatile int*>(8) = 1; }

const std::array<Death, 9> kDeaths{{
    {"it returns", 7, 0, true, [](const Event&) { return 7; }, false},
    {"_exit()", 9, 0, false, [](const Event&) -> int { ::_exit(9); }, false},
    {"fault", 0, SIGSEGV, false,
     [](const Event&) {
       fault();
       return 0;
     },
     false},
    {"SIGKILL to itself", 0, SIGKILL, false,
     [](const Event&) -> int {
       ::kill(::getpid(), SIGKILL);
       sleep_for_ever();
     },
     false},
    {"exit_group in a second thread", 11, 0, false,
     [](const Event&) -> int {
       std::thread([] { ::syscall(SYS_exit_group, 11); }).detach();
       sleep_for_ever();
     },
     false},
    {"fault in a second thread", 0, SIGSEGV, false,
     [](const Event&) -> int {
       std::thread(fault).detach();
       sleep_for_ever();
     },
     false},
    {"first thread gone before the process", 12, 0, false,
     [](const Event&) -> int {
       std::thread([] {
         ::usleep(200);
         ::syscall(SYS_exit_group, 12);
       }).detach();
       ::syscall(SYS_exit, 0);
       sleep_for_ever();
     },
     false},
    {"killed asleep", 0, SIGKILL, false,
     [](const Event& alive) -> int {
       alive.set();
       sleep_for_ever();
     },
     true},
    {"killed while it runs", 0, SIGKILL, false,
     [](const Event& alive) -> int {
       alive.set();
       while (true) {
         asm volatile("");
       }
     },
     true},
}};

/// One child, and whether its end is reported as it was; false: the donor went on before that.
void die_once(const Death& death) {
  Event alive;
  Program program([&](Program&) { return death.way(alive); });
  CrashSlot slot;
  ChildEnd end;
  ChildOptions options;
  options.dies_abruptly = true;
  DonorThread donor("donor", [&] { end = run_in_child(program, slot, options); });
  if (death.from_outside) {
    alive.wait();
    CHECK(send_signal(slot, SIGKILL));
  }
  donor.join();
  const bool right = end.error == 0 && end.exit_code == death.exit_code &&
                     end.signal == death.signal && end.returned == death.returned;
  if (!right) {
    std::printf("%s: error %d, exit code %d, signal %d, returned %d\n", death.name, end.error,
                end.exit_code, end.signal, end.returned);
  }
  CHECK(right);
}

void test_deaths(int rounds) {
  for (int i = 0; i < rounds; ++i) {
    die_once(kDeaths[static_cast<std::size_t>(i) % kDeaths.size()]);
  }
}

/// Stops reach the donor in the middle of its wait, which then begins anew.
void test_deaths_between_stops() {
  constexpr int kRounds = 400;
  const pid_t container = ::fork();
  CHECK(container >= 0);
  if (container == 0) {
    test_deaths(kRounds);
    ::_exit(0);
  }
  int status = 0;
  while (::waitpid(container, &status, WNOHANG) == 0) {
    CHECK(::kill(container, SIGSTOP) == 0);
    CHECK(::waitpid(container, &status, WUNTRACED) == container);
    if (!WIFSTOPPED(status)) {
      break;
    }
    CHECK(::kill(container, SIGCONT) == 0);
    ::usleep(1000);
  }
  CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

/// The C library signals each of its threads and waits for the answers.
void test_ids_of_the_container_can_change() {
  const Sleepers sleepers(3);
  CHECK(::setresgid(static_cast<gid_t>(-1), ::getegid(), static_cast<gid_t>(-1)) == 0);
}

void* sleep_until_cancelled(void*) { sleep_for_ever(); }

void cancel_a_thread() {
  pthread_t thread{};
  CHECK(::pthread_create(&thread, nullptr, sleep_until_cancelled, nullptr) == 0);
  CHECK(::pthread_cancel(thread) == 0);
  void* result = nullptr;
  CHECK(::pthread_join(thread, &result) == 0 && result == PTHREAD_CANCELED);
}

/// The handler behind it is a process's own, the C library's note that it is installed is not.
void test_threads_are_cancelled_in_all_processes() {
  for (int i = 0; i < 2; ++i) {
    Outcome outcome;
    run(outcome, [](Program&) {
      cancel_a_thread();
      return 0;
    });
    CHECK(outcome.end.clean());
  }
  cancel_a_thread();
}

/// As for a user with too many pending signals.
void test_it_begins_where_no_signal_can_be_queued() {
  const pid_t container = ::fork();
  CHECK(container >= 0);
  if (container == 0) {
    const rlimit none{0, 0};
    CHECK(::setrlimit(RLIMIT_SIGPENDING, &none) == 0);
    CHECK(prepare_clone() == nullptr);
    die_once(kDeaths.front());
    ::_exit(0);
  }
  int status = 0;
  CHECK(::waitpid(container, &status, 0) == container);
  CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

}  // namespace

int main() {
  const rlimit no_cores{0, 0};
  ::setrlimit(RLIMIT_CORE, &no_cores);
  test_it_begins_where_no_signal_can_be_queued();
  // Before all that is in this process: later it would find the handler installed.
  CHECK(prepare_clone() == nullptr);
  test_threads_are_cancelled_in_all_processes();
  prepare_crash_handling();
  test_donors_do_not_count_as_load();
  test_the_container_can_be_stopped_and_goes_on();
  test_deaths(900);
  test_deaths_between_stops();
  test_ids_of_the_container_can_change();
  return 0;
}
