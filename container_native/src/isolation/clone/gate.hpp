#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "isolation/clone/probe.hpp"

namespace play_launch::isolation {

/// How nodes are kept in processes of their own.
enum class Mechanism {
  shared_memory,  // processes that share the container's memory: messages go by pointer
  process,        // a program of its own for every node: messages go through the middleware
};

/// What was asked for on the command line.
enum class MechanismChoice { automatic, shared_memory, process };

/// "auto", "shared_memory" or "process"; else nothing.
std::optional<MechanismChoice> parse_mechanism_choice(std::string_view text);
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
