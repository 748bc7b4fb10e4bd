// How a process that holds nodes as threads reports what it dies of.

#include "isolation/crash/own_crash.hpp"

#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <string>
#include <thread>

#include "harness.hpp"

using namespace isolation_test;

namespace {

struct Death {
  int status = 0;
  std::string said;
};

/// Runs a test in a process of its own, which writes what is reported to the descriptor.
Death death_of(void (*test)(int said)) {
  int ends[2] = {-1, -1};
  CHECK(::pipe(ends) == 0);
  const pid_t pid = ::fork();
  CHECK(pid >= 0);
  if (pid == 0) {
    ::close(ends[0]);
    const rlimit none{};
    ::setrlimit(RLIMIT_CORE, &none);
    test(ends[1]);
    std::_Exit(77);
  }
  ::close(ends[1]);
  Death death;
  char part[512];
  for (ssize_t size; (size = ::read(ends[0], part, sizeof part)) > 0;) {
    death.said.append(part, static_cast<std::size_t>(size));
  }
  ::close(ends[0]);
  CHECK(::waitpid(pid, &death.status, 0) == pid);
  return death;
}

bool died_of(const Death& death, int signal) {
  return WIFSIGNALED(death.status) && WTERMSIG(death.status) == signal;
}

void say(int said, const std::string& text) {
  CHECK(::write(said, text.data(), text.size()) == static_cast<ssize_t>(text.size()));
}

void fault() { *reinterpret_cast<volatile int*>(8) = 1; }

void test_a_report_that_does_not_end_holds_up_for_a_second() {
  const std::uint64_t begin = now_ns();
  const Death death = death_of([](int) {
    const OwnCrashWatch watch([](const CrashSlot&) { ::pause(); });
    fault();
  });
  CHECK(died_of(death, SIGSEGV));
  CHECK(now_ns() - begin >= 1'000'000'000u);
}

void test_a_report_that_fails_is_survived() {
  const Death death = death_of([](int said) {
    const OwnCrashWatch watch([said](const CrashSlot&) {
      say(said, "begun");
      fault();
    });
    ::raise(SIGFPE);
  });
  CHECK(died_of(death, SIGFPE) && death.said == "begun");
  const Death aborted = death_of([](int) {
    const OwnCrashWatch watch([](const CrashSlot&) { std::abort(); });
    fault();
  });
  CHECK(died_of(aborted, SIGSEGV));
}

void test_many_threads_at_once_are_one_crash() {
  const Death death = death_of([](int said) {
    const OwnCrashWatch watch([said](const CrashSlot&) { say(said, "x"); });
    std::thread others[8];
    for (std::thread& each : others) {
      each = std::thread(fault);
    }
    for (std::thread& each : others) {
      each.join();
    }
  });
  CHECK(died_of(death, SIGSEGV) && death.said == "x");
}

void test_what_others_send_is_not_reported() {
  const Death death = death_of([](int said) {
    const OwnCrashWatch watch([said](const CrashSlot&) { say(said, "x"); });
    const pid_t parent = ::getpid();
    if (::fork() == 0) {
      ::kill(parent, SIGSEGV);
      std::_Exit(0);
    }
    while (true) {
      ::pause();
    }
  });
  CHECK(died_of(death, SIGSEGV) && death.said.empty());
}

void test_processes_of_nodes_are_not_reported() {
  const Death death = death_of([](int said) {
    const OwnCrashWatch watch([said](const CrashSlot&) { say(said, "x"); });
    const pid_t pid = ::fork();
    if (pid == 0) {
      fault();
    }
    int status = 0;
    CHECK(::waitpid(pid, &status, 0) == pid && WIFSIGNALED(status));
    std::_Exit(WTERMSIG(status) == SIGSEGV ? 5 : 6);
  });
  CHECK(WIFEXITED(death.status) && WEXITSTATUS(death.status) == 5 && death.said.empty());
}

}  // namespace

int main() {
  test_a_report_that_does_not_end_holds_up_for_a_second();
  test_a_report_that_fails_is_survived();
  test_many_threads_at_once_are_one_crash();
  test_what_others_send_is_not_reported();
  test_processes_of_nodes_are_not_reported();
  return 0;
}
