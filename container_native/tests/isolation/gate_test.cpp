// Which mechanism is chosen for which machine, and what is said about it.

#include "isolation/clone/gate.hpp"

#include <cerrno>

#include "../container/check.hpp"

namespace {

using namespace play_launch::isolation;

Facts good_machine() { return {6, 8, "6.8.0-generic", 0, "mimalloc"}; }

void test_choices() {
  CHECK(parse_mechanism_choice("auto") == MechanismChoice::automatic);
  CHECK(parse_mechanism_choice("shared_memory") == MechanismChoice::shared_memory);
  CHECK(parse_mechanism_choice("process") == MechanismChoice::process);
  CHECK(!parse_mechanism_choice("threads"));
  CHECK(mechanism_name(Mechanism::shared_memory) == "shared_memory");
  CHECK(mechanism_name(Mechanism::process) == "process");
}

void test_good_machine() {
  const Gate gate = choose_mechanism(MechanismChoice::automatic, good_machine());
  CHECK(gate.mechanism == Mechanism::shared_memory && gate.notes.empty());
  const Gate asked = choose_mechanism(MechanismChoice::process, good_machine());
  CHECK(asked.mechanism == Mechanism::process && asked.notes.empty());
}

void test_old_kernel() {
  Facts facts = good_machine();
  facts.kernel_major = 5;
  facts.kernel_minor = 15;
  facts.kernel_release = "5.15.0-generic";
  const Gate gate = choose_mechanism(MechanismChoice::automatic, facts);
  CHECK(gate.mechanism == Mechanism::process);
  CHECK(gate.notes.size() == 1 && contains(gate.notes[0], "5.15.0-generic"));
  const std::string refusal =
      CHECK_THROWS(choose_mechanism(MechanismChoice::shared_memory, facts), MechanismUnavailable);
  CHECK(contains(refusal, "5.16") && contains(refusal, "isolation: process"));
  facts.kernel_minor = 16;
  CHECK(choose_mechanism(MechanismChoice::automatic, facts).mechanism == Mechanism::shared_memory);
}

void test_release_strings() {
  struct Case {
    const char* release;
    Mechanism mechanism;
  };
  for (const Case& known :
       {Case{"5.15.0-91-generic", Mechanism::process}, Case{"4.19.0", Mechanism::process},
        Case{"5.15.146.1-microsoft-standard-WSL2", Mechanism::process},
        Case{"5.16.0", Mechanism::shared_memory}, Case{"5.16-rc1", Mechanism::shared_memory},
        Case{"6.1.0-18-amd64", Mechanism::shared_memory}, Case{"10.0", Mechanism::shared_memory},
        Case{"who knows", Mechanism::process}}) {
    Facts facts = good_machine();
    set_kernel(facts, known.release);
    const Gate gate = choose_mechanism(MechanismChoice::automatic, facts);
    CHECK(gate.mechanism == known.mechanism);
    CHECK(gate.notes.size() == (known.mechanism == Mechanism::process ? 1u : 0u));
    CHECK(gate.notes.empty() || (contains(gate.notes[0], known.release) &&
                                 contains(gate.notes[0], "must be 5.16 or newer") &&
                                 contains(gate.notes[0], "a program of its own instead")));
  }
}

void test_no_clone() {
  Facts facts = good_machine();
  facts.clone_error = EPERM;
  const Gate gate = choose_mechanism(MechanismChoice::automatic, facts);
  CHECK(gate.mechanism == Mechanism::process);
  CHECK(contains(gate.notes.at(0), "Operation not permitted"));
}

void test_other_allocator() {
  Facts facts = good_machine();
  facts.allocator.clear();
  const Gate gate = choose_mechanism(MechanismChoice::automatic, facts);
  CHECK(gate.mechanism == Mechanism::shared_memory);
  CHECK(gate.notes.size() == 1 && contains(gate.notes[0], "libmimalloc2.0"));
}

void test_this_machine() {
  const Facts facts = look_at_machine();
  CHECK(facts.kernel_major > 0 && !facts.kernel_release.empty());
  const char* const preload = std::getenv("LD_PRELOAD");
  const bool expected = preload != nullptr && contains(preload, "mimalloc");
  CHECK((facts.allocator == "mimalloc") == expected);
}

}  // namespace

int main() {
  test_choices();
  test_good_machine();
  test_old_kernel();
  test_release_strings();
  test_no_clone();
  test_other_allocator();
  test_this_machine();
  return 0;
}
