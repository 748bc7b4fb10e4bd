// Which mechanism is chosen for which machine, and what is said about it.

#include "isolation/clone/gate.hpp"

#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>

#include "check.hpp"

namespace {

using namespace play_launch::isolation;

Facts good_machine() {
  Facts facts;
  facts.kernel_release = "6.8.0-generic";
  facts.probe = {true, 0, true, true, 0};
  facts.allocator = "mimalloc";
  return facts;
}

/// What is said when memory cannot be shared: a note, or a refusal when it was asked for.
void check_falls_back(const Facts& facts, const char* reason) {
  const Gate gate = choose_mechanism(MechanismChoice::automatic, facts);
  CHECK(gate.mechanism == Mechanism::process);
  CHECK(gate.notes.size() == 1 && contains(gate.notes[0], reason) &&
        contains(gate.notes[0], "a program of its own instead"));
  const std::string refusal =
      CHECK_THROWS(choose_mechanism(MechanismChoice::shared_memory, facts), MechanismUnavailable);
  CHECK(contains(refusal, reason) && contains(refusal, "isolation: process"));
}

void test_choices() {
  CHECK(mechanism_name(Mechanism::shared_memory) == "shared_memory");
  CHECK(mechanism_name(Mechanism::process) == "process");
}

void test_good_machine() {
  const Gate gate = choose_mechanism(MechanismChoice::automatic, good_machine());
  CHECK(gate.mechanism == Mechanism::shared_memory && gate.notes.empty());
  const Gate asked = choose_mechanism(MechanismChoice::process, good_machine());
  CHECK(asked.mechanism == Mechanism::process && asked.notes.empty());
}

void test_a_kernel_whose_core_dumps_spread() {
  Facts facts = good_machine();
  facts.kernel_release = "5.15.0-generic";
  facts.probe.ends_by_kill = true;
  for (const MechanismChoice choice :
       {MechanismChoice::automatic, MechanismChoice::shared_memory}) {
    const Gate gate = choose_mechanism(choice, facts);
    CHECK(gate.mechanism == Mechanism::shared_memory && gate.notes.empty());
    CHECK(contains(gate.limit, "5.15.0-generic") && contains(gate.limit, "leave no core"));
  }
  CHECK(choose_mechanism(MechanismChoice::process, facts).limit.empty());
}

void test_machines_that_cannot_share_memory() {
  Facts spreads = good_machine();
  spreads.kernel_release = "5.15.0-generic";
  spreads.probe.survives_crash = false;
  check_falls_back(spreads, "with Linux 5.15.0-generic a crash ends every process");
  Facts no_clone = good_machine();
  no_clone.probe = {false, EPERM, false, true, 0};
  check_falls_back(no_clone, "Operation not permitted");
  Facts no_waitid = good_machine();
  no_waitid.probe = {false, 0, false, true, 0};
  check_falls_back(no_waitid, "cannot be waited for");
  Facts other_library = good_machine();
  other_library.obstacle = "the C library does not say it";
  check_falls_back(other_library, "the C library does not say it");
}

void test_no_descriptors_of_processes() {
  Facts facts = good_machine();
  facts.kernel_release = "4.18.0";
  facts.probe.waits_by_descriptor = false;
  CHECK(choose_mechanism(MechanismChoice::automatic, facts).mechanism == Mechanism::shared_memory);
  facts.probe.survives_crash = false;
  for (const MechanismChoice choice : {MechanismChoice::automatic, MechanismChoice::process}) {
    const std::string refusal = CHECK_THROWS(choose_mechanism(choice, facts), MechanismUnavailable);
    CHECK(contains(refusal, "pidfd_open") && contains(refusal, "4.18.0"));
  }
}

void test_waits_that_cannot_be_read() {
  Facts facts = good_machine();
  facts.probe.syscall_error = EPERM;
  const Gate gate = choose_mechanism(MechanismChoice::automatic, facts);
  CHECK(gate.mechanism == Mechanism::shared_memory && gate.notes.size() == 1);
  CHECK(contains(gate.notes[0], "syscall: Operation not permitted") &&
        contains(gate.notes[0], "ptrace_scope"));
  CHECK(choose_mechanism(MechanismChoice::process, facts).notes.empty());
}

/// A process that may not be looked into, as with a program file that may not be read.
void test_hidden_process() {
  CHECK(look_at_machine().probe.syscall_error == 0);
  const pid_t pid = ::fork();
  CHECK(pid >= 0);
  if (pid == 0) {
    // The superuser may look into everything.
    CHECK(::geteuid() != 0 ||
          (::setresgid(1000, 1000, 1000) == 0 && ::setresuid(1000, 1000, 1000) == 0));
    CHECK(::prctl(PR_SET_DUMPABLE, 0) == 0);
    std::_Exit(look_at_machine().probe.syscall_error != 0 ? 0 : 1);
  }
  int status = -1;
  CHECK(::waitpid(pid, &status, 0) == pid && status == 0);
}

void test_other_allocator() {
  Facts facts = good_machine();
  facts.allocator.clear();
  const Gate gate = choose_mechanism(MechanismChoice::automatic, facts);
  CHECK(gate.mechanism == Mechanism::shared_memory);
  CHECK(gate.notes.size() == 1 && contains(gate.notes[0], "cmeel-mimalloc"));
}

void test_other_code_of_the_c_library() {
  Facts facts = good_machine();
  facts.missing_landmarks = {"stdio", "mutexes"};
  const Gate gate = choose_mechanism(MechanismChoice::automatic, facts);
  CHECK(gate.mechanism == Mechanism::shared_memory && gate.notes.size() == 1);
  CHECK(contains(gate.notes[0], "stdio, mutexes") && contains(gate.notes[0], "isolation: process"));
  CHECK(choose_mechanism(MechanismChoice::process, facts).notes.empty());
}

void test_this_machine() {
  const Facts facts = look_at_machine();
  CHECK(!facts.kernel_release.empty() && facts.obstacle.empty());
  CHECK(facts.probe.shares_memory && facts.probe.survives_crash && facts.probe.waits_by_descriptor);
  const char* const preload = std::getenv("LD_PRELOAD");
  const bool expected = preload != nullptr && contains(preload, "mimalloc");
  CHECK((facts.allocator == "mimalloc") == expected);
  CHECK(facts.missing_landmarks.empty());
}

}  // namespace

int main() {
  test_choices();
  test_good_machine();
  test_a_kernel_whose_core_dumps_spread();
  test_machines_that_cannot_share_memory();
  test_no_descriptors_of_processes();
  test_waits_that_cannot_be_read();
  test_other_allocator();
  test_other_code_of_the_c_library();
  test_this_machine();
  test_hidden_process();
  return 0;
}
