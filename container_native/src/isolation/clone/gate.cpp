#include "isolation/clone/gate.hpp"

#include <dlfcn.h>
#include <sys/utsname.h>

#include <cstring>

#include "isolation/clone/vm_clone.hpp"
#include "isolation/quiesce/code_map.hpp"

namespace play_launch::isolation {
namespace {

bool exists(const char* symbol) { return ::dlsym(RTLD_DEFAULT, symbol) != nullptr; }

/// Whose malloc this program uses, as far as it has a name that matters here.
std::string allocator_in_use() {
  // Loaded is not enough: it must be the one that malloc() is.
  void* const malloc = ::dlsym(RTLD_DEFAULT, "malloc");
  Dl_info place{};
  if (malloc == nullptr || ::dladdr(malloc, &place) == 0 || place.dli_fname == nullptr) {
    return {};
  }
  const std::string library = place.dli_fname;
  for (const char* const name : {"mimalloc", "jemalloc"}) {
    if (library.find(name) != std::string::npos) {
      return name;
    }
  }
  if (exists("mi_malloc") && ::dlsym(RTLD_DEFAULT, "mi_malloc") == malloc) {
    return "mimalloc";
  }
  return {};
}

std::string why_not(const Facts& facts) {
  if (!facts.obstacle.empty()) {
    return facts.obstacle + " (processes cannot share memory then)";
  }
  if (facts.probe.clone_error != 0) {
    return std::string("processes that share memory cannot be made here (clone: ") +
           std::strerror(facts.probe.clone_error) + ")";
  }
  if (!facts.probe.shares_memory) {
    return "processes that share memory cannot be waited for here (does a filter forbid waitid?)";
  }
  if (!facts.probe.survives_crash) {
    return "with Linux " + facts.kernel_release +
           " a crash ends every process that shares the memory (since 5.16 it does not)";
  }
  return {};
}

Gate with_processes(const Facts& facts) {
  if (!facts.probe.waits_by_descriptor) {
    throw MechanismUnavailable(
        "nodes cannot be isolated here: isolation: process needs pidfd_open (Linux 5.4 or newer, "
        "where no filter forbids it; this is " +
        facts.kernel_release + ")");
  }
  return {};
}

}  // namespace

std::optional<MechanismChoice> parse_mechanism_choice(std::string_view text) {
  if (text == "auto") {
    return MechanismChoice::automatic;
  }
  if (text == "shared_memory") {
    return MechanismChoice::shared_memory;
  }
  if (text == "process") {
    return MechanismChoice::process;
  }
  return std::nullopt;
}

std::string_view mechanism_name(Mechanism mechanism) {
  return mechanism == Mechanism::shared_memory ? "shared_memory" : "process";
}

Facts look_at_machine() {
  Facts facts;
  utsname system{};
  if (::uname(&system) == 0) {
    facts.kernel_release = system.release;
  }
  if (const char* const obstacle = prepare_clone()) {
    facts.obstacle = obstacle;
  }
  facts.probe = probe_machine();
  facts.allocator = allocator_in_use();
  facts.missing_landmarks = find_landmarks();
  return facts;
}

Gate choose_mechanism(MechanismChoice choice, const Facts& facts) {
  if (choice == MechanismChoice::process) {
    return with_processes(facts);
  }
  const std::string obstacle = why_not(facts);
  if (!obstacle.empty()) {
    if (choice == MechanismChoice::shared_memory) {
      throw MechanismUnavailable("isolation in shared memory was asked for, but " + obstacle +
                                 "; use isolation: process");
    }
    Gate gate = with_processes(facts);
    gate.notes.push_back(obstacle +
                         "; every node is a program of its own instead (isolation: process), and "
                         "messages between nodes are copied through the middleware");
    return gate;
  }
  Gate gate;
  gate.mechanism = Mechanism::shared_memory;
  if (facts.probe.syscall_error != 0) {
    gate.notes.push_back(
        std::string("what threads of nodes wait for cannot be read here "
                    "(/proc/<pid>/task/<tid>/syscall: ") +
        std::strerror(facts.probe.syscall_error) +
        "): a lock that a killed node held is not found, and only reloads that hang show it; set "
        "kernel.yama.ptrace_scope to 0 or 1, and mount /proc without hidepid");
  }
  if (facts.allocator.empty()) {
    gate.notes.push_back(
        "malloc is neither mimalloc nor jemalloc: a node that dies while it allocates can freeze "
        "its whole container, which is then restarted; the supervisor preloads mimalloc where it "
        "finds it (pip install cmeel-mimalloc, or your distribution's); without a supervisor, "
        "start the container with LD_PRELOAD=/path/to/libmimalloc.so");
  }
  if (!facts.missing_landmarks.empty()) {
    std::string names;
    for (const std::string& name : facts.missing_landmarks) {
      names += (names.empty() ? "" : ", ") + name;
    }
    gate.notes.push_back(
        "code of the C and the C++ library is not where it is expected (" + names +
        "): whether a thread of a dying node holds a lock there is not known, and a node that dies "
        "can freeze its whole container, which is then restarted; with isolation: process it "
        "cannot");
  }
  return gate;
}

}  // namespace play_launch::isolation
