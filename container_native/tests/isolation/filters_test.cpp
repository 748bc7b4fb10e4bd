// Machines that refuse clone3, both ways to make a process that shares memory, or waiting for one:
// nodes run by the other way, or the gate gives the reason.

#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <stdexcept>
#include <thread>

#include "harness.hpp"
#include "isolation/clone/gate.hpp"
#include "isolation/clone/vm_clone.hpp"
#include "isolation/record/own_signals.hpp"

namespace {

using namespace isolation_test;

constexpr sock_filter load(std::uint32_t offset) {
  return BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offset);
}

constexpr sock_filter answer(int error) {
  return BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | static_cast<std::uint32_t>(error));
}

/// From now on clone3 fails with ENOSYS, as the filters of container runtimes have it, and if asked
/// for, clone with EPERM where memory is shared, but for threads. (With any other error for clone3,
/// the C library starts no threads either.)
void refuse_clone3(bool clone_too) {
  constexpr std::uint32_t kMemory = 0x00000100;  // CLONE_VM
  constexpr std::uint32_t kThread = 0x00010000;  // CLONE_THREAD
  const std::array<sock_filter, 9> program{
      load(offsetof(seccomp_data, nr)),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_clone3, 0, 1),
      answer(ENOSYS),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_clone, 0, 4),
      load(offsetof(seccomp_data, args[0])),
      BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, clone_too ? kMemory : 0, 0, 2),
      BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, kThread, 1, 0),
      answer(EPERM),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
  };
  const sock_fprog filter{program.size(), const_cast<sock_filter*>(program.data())};
  CHECK(::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0);
  CHECK(::prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &filter) == 0);
}

/// From now on waitid() fails, and no timer can be had.
void refuse_waitid_and_timers() {
  const std::array<sock_filter, 4> program{
      load(offsetof(seccomp_data, nr)),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_waitid, 0, 1),
      answer(ENOSYS),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
  };
  const sock_fprog filter{program.size(), const_cast<sock_filter*>(program.data())};
  CHECK(::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0);
  CHECK(::prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &filter) == 0);
  const rlimit none{0, 0};
  CHECK(::setrlimit(RLIMIT_SIGPENDING, &none) == 0);
  timer_t timer{};
  CHECK(::timer_create(CLOCK_MONOTONIC, nullptr, &timer) != 0);
}

volatile std::uintptr_t bad_address = 8;

void test_nodes_run_by_clone() {
  refuse_clone3(false);
  CHECK(::syscall(SYS_clone3, nullptr, 0) == -1 && errno == ENOSYS);
  const Facts facts = look_at_machine();
  CHECK(facts.probe.clone_error == 0);
  CHECK(choose_mechanism(MechanismChoice::automatic, facts).mechanism == Mechanism::shared_memory);

  for (int i = 0; i < 20; ++i) {
    Outcome outcome;
    int value = 0;
    run(outcome, [&value](Program&) {
      CHECK(::getpid() == ::gettid());
      try {
        throw std::runtime_error("caught");
      } catch (const std::exception&) {
        std::thread([&value] { value = 7; }).join();
      }
      return 5;
    });
    CHECK(outcome.end.error == 0 && outcome.end.returned && outcome.end.exit_code == 5);
    CHECK(outcome.end.pid != ::getpid() && value == 7);

    run(outcome, [](Program&) {
      *reinterpret_cast<volatile int*>(bad_address) = 1;
      return 0;
    });
    CHECK(outcome.end.signal == SIGSEGV && !outcome.end.returned);
    CHECK(contains(outcome.text(), "address 0x8"));
  }
}

void test_both_are_refused() {
  refuse_clone3(true);
  const Facts facts = look_at_machine();
  CHECK(facts.probe.clone_error == EPERM);
  const Gate gate = choose_mechanism(MechanismChoice::automatic, facts);
  CHECK(gate.mechanism == Mechanism::process);
  CHECK(contains(gate.notes.at(0), "Operation not permitted"));
  CHECK_THROWS(choose_mechanism(MechanismChoice::shared_memory, facts), MechanismUnavailable);

  Outcome outcome;
  run(outcome, [](Program&) { return 0; });
  CHECK(outcome.end.error == EPERM && outcome.end.pid == 0);
}

void test_no_child_can_be_waited_for() {
  refuse_waitid_and_timers();
  const Facts facts = look_at_machine();
  CHECK(!facts.probe.shares_memory);
  CHECK_THROWS(choose_mechanism(MechanismChoice::shared_memory, facts), MechanismUnavailable);
}

/// In a process of its own, as filters cannot be taken back.
void in_a_fork(void (*test)()) {
  const pid_t pid = ::fork();
  CHECK(pid >= 0);
  if (pid == 0) {
    prepare_crash_handling();
    test();
    std::_Exit(0);
  }
  int status = 0;
  CHECK(::waitpid(pid, &status, 0) == pid);
  CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

}  // namespace

int main() {
  in_a_fork(test_nodes_run_by_clone);
  in_a_fork(test_both_are_refused);
  in_a_fork(test_no_child_can_be_waited_for);
  return 0;
}
