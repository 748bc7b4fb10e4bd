// Signals from outside ask a child to leave; limits on its life hold.

#include <signal.h>
#include <sys/resource.h>

#include <array>
#include <atomic>
#include <chrono>
#include <string>
#include <thread>

#include "harness.hpp"

namespace {

using namespace isolation_test;
using namespace std::chrono_literals;

/// Lets a child run, and does something to it from the container once it does.
void with_child(Outcome& outcome, std::function<int(Program&)> body, const ChildOptions& options,
                const std::function<void(Outcome&)>& act) {
  Event running;
  Program program([&](Program& self) {
    running.set();
    return body(self);
  });
  DonorThread donor("donor", [&] { outcome.end = run_in_child(program, outcome.slot, options); });
  running.wait();
  act(outcome);
}

int until_cancelled(Program& program) {
  while (!program.cancelled) {
    std::this_thread::sleep_for(1ms);
  }
  return 0;
}

int deaf(Program&) {
  while (true) {
    std::this_thread::sleep_for(1h);
  }
}

void test_leaves_in_order() {
  for (const int signal : {SIGTERM, SIGINT,    SIGHUP,  SIGQUIT, SIGUSR1, SIGUSR2, SIGALRM,
                           SIGPROF, SIGVTALRM, SIGIO,   SIGPWR,  SIGSEGV, SIGBUS,  SIGFPE,
                           SIGILL,  SIGABRT,   SIGTRAP, SIGSYS,  SIGXCPU, SIGXFSZ}) {
    Outcome outcome;
    bool left = false;
    with_child(
        outcome,
        [&left](Program& program) {
          until_cancelled(program);
          left = true;
          return 0;
        },
        {}, [signal](Outcome& running) { CHECK(send_signal(running.slot, signal)); });
    CHECK(left && outcome.end.returned);
    CHECK(outcome.end.signal == signal);
    CHECK(outcome.slot.stop_signal == signal);
    CHECK(outcome.slot.stop_sender == ::getpid());
    CHECK(outcome.slot.thread == 0);
    CHECK(contains(outcome.text(), "sent by process " + std::to_string(::getpid())));
    CHECK(!send_signal(outcome.slot, 0));
  }
}

/// One that takes a signal for something of its own keeps it.
void test_handler_of_its_own() {
  static std::atomic<bool> handled{false};
  handled = false;
  Outcome outcome;
  Event ready;
  Program program([&](Program& self) {
    ::signal(SIGUSR1, [](int) { handled = true; });
    ready.set();
    return until_cancelled(self);
  });
  DonorThread donor("donor", [&] { outcome.end = run_in_child(program, outcome.slot); });
  ready.wait();
  CHECK(send_signal(outcome.slot, SIGUSR1));
  while (!handled) {
    std::this_thread::yield();
  }
  program.cancelled = true;
  donor.join();
  CHECK(outcome.end.clean());
}

/// As after nohup.
void test_what_the_container_ignores() {
  ::signal(SIGHUP, SIG_IGN);
  Outcome outcome;
  with_child(outcome, until_cancelled, {}, [](Outcome& running) {
    CHECK(send_signal(running.slot, SIGHUP));
    CHECK(send_signal(running.slot, SIGTERM));
  });
  ::signal(SIGHUP, SIG_DFL);
  CHECK(outcome.end.signal == SIGTERM);
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

void test_one_that_does_not_leave() {
  Outcome outcome;
  with_child(outcome, deaf, {.leave_limit = 50ms},
             [](Outcome& running) { CHECK(send_signal(running.slot, SIGTERM)); });
  CHECK(outcome.end.signal == SIGTERM && !outcome.end.returned);
  CHECK(outcome.slot.thread != 0);
  CHECK(contains(outcome.text(), "did not leave in time"));
  CHECK(contains(joined(outcome.slot), "deaf"));
}

/// Most probably the signal finds it in the kernel's own library (vDSO), whose tables are not where
/// a library's usually are.
int read_the_clock(Program&) {
  while (true) {
    static_cast<void>(std::chrono::steady_clock::now());
  }
}

void test_one_that_reads_a_clock() {
  bool in_vdso = false;
  for (int round = 0; round < 200 && !in_vdso; ++round) {
    Outcome outcome;
    with_child(outcome, read_the_clock, {.leave_limit = 5ms},
               [](Outcome& running) { CHECK(send_signal(running.slot, SIGTERM)); });
    CHECK(outcome.end.signal == SIGTERM);
    const std::string backtrace = joined(outcome.slot);
    CHECK(contains(backtrace, "read_the_clock"));
    in_vdso = contains(backtrace, "#0 __vdso_clock_gettime") && contains(backtrace, "(linux-vdso");
  }
  CHECK(in_vdso);
}

void test_crash_while_leaving() {
  Outcome outcome;
  with_child(
      outcome,
      [](Program& program) {
        until_cancelled(program);
        *reinterpret_cast<volatile int*>(::getpid() & 0) = 1;
        return 0;
      },
      {}, [](Outcome& running) { CHECK(send_signal(running.slot, SIGTERM)); });
  CHECK(outcome.end.signal == SIGSEGV && outcome.slot.report.signal == SIGSEGV);
}

void test_time_limit() {
  Outcome outcome;
  with_child(outcome, deaf, {.time_limit = 20ms}, [](Outcome&) {});
  CHECK(outcome.end.signal == SIGKILL);
}

void test_name() {
  Outcome outcome;
  std::array<char, 32> name{};
  with_child(
      outcome,
      [&name](Program&) {
        ::pthread_getname_np(::pthread_self(), name.data(), name.size());
        return 0;
      },
      {.name = "a_rather_long_name"}, [](Outcome&) {});
  CHECK(std::string(name.data()) == "a_rather_long_n");
  CHECK(outcome.end.clean());
}

/// Signals while children come and go never hit another process, and the child always dies of them.
void test_signals_at_any_instant() {
  for (int round = 0; round < 300; ++round) {
    Outcome outcome;
    Program program(until_cancelled);
    DonorThread donor("donor", [&] { outcome.end = run_in_child(program, outcome.slot); });
    const int signal = round % 2 == 0 ? SIGTERM : SIGSEGV;
    while (!send_signal(outcome.slot, signal)) {
      std::this_thread::yield();
    }
    donor.join();
    CHECK(outcome.end.signal == signal);
    CHECK(outcome.end.returned);
  }
}

}  // namespace

int main() {
  prepare_crash_handling();
  test_leaves_in_order();
  test_handler_of_its_own();
  test_what_the_container_ignores();
  test_limits_of_the_kernel();
  test_one_that_does_not_leave();
  test_one_that_reads_a_clock();
  test_crash_while_leaving();
  test_time_limit();
  test_name();
  test_signals_at_any_instant();
  return 0;
}
