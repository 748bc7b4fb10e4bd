#pragma once

#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace play_launch::isolation {

/// Result of a process that was made to try the following out.
struct Probe {
  /// It made a child that shares its memory, and waited for its end.
  bool shares_memory = false;
  /// errno, when it could not even make one; else 0.
  int clone_error = 0;
  /// It lived on when such a child died of a signal that dumps core.
  bool survives_crash = false;
  /// It could be waited for by a descriptor (pidfd_open, Linux 5.4).
  bool waits_by_descriptor = false;
  /// 0, or the errno of reading what it sleeps in, which DeadLockSearch needs of every node:
  /// /proc/<pid>/task/<tid>/syscall.
  int syscall_error = 0;
  /// It lived on only when that child ended by SIGKILL instead, see end_children_by_kill().
  bool ends_by_kill = false;
};

/// How nodes are kept in processes of their own.
enum class Mechanism {
  shared_memory,  // processes that share the container's memory: messages go by pointer
  process,        // a program of its own for every node: messages go through the middleware
};

/// What was asked for on the command line.
enum class MechanismChoice { automatic, shared_memory, process };

/// "shared_memory" or "process".
std::string_view mechanism_name(Mechanism mechanism);

/// The mechanism that was asked for cannot work here; the text has the cause and the fix.
class MechanismUnavailable : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct Gate {
  Mechanism mechanism = Mechanism::process;
  /// One line each: what this machine lacks, what happens instead, and how to change it.
  std::vector<std::string> notes;
  /// What holds here and cannot be changed; empty: nothing.
  std::string limit;
};

/// What is known about the machine; apart from the decision so that this can be tested.
struct Facts {
  std::string kernel_release;
  /// What prepare_clone() says against sharing memory; empty: nothing.
  std::string obstacle;
  Probe probe;
  /// "mimalloc", "jemalloc", or empty when malloc is another.
  std::string allocator;
  /// See find_landmarks().
  std::vector<std::string> missing_landmarks;
};

Facts look_at_machine();

/// Throws MechanismUnavailable when shared_memory was demanded and cannot be, or neither can be.
Gate choose_mechanism(MechanismChoice choice, const Facts& facts);

}  // namespace play_launch::isolation
