#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

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

/// The mechanism that was asked for cannot work here; the text says why and what to do.
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
  int kernel_major = 0;
  int kernel_minor = 0;
  std::string kernel_release;
  /// 0, or the errno of trying to make a child.
  int clone_error = 0;
  /// "mimalloc", "jemalloc", or empty when malloc is another.
  std::string allocator;
};

/// What look_at_machine() takes from the name of a kernel's release, such as "5.15.0-91-generic";
/// 0.0 for one that it does not understand.
void set_kernel(Facts& facts, const std::string& release);

Facts look_at_machine();

/// Throws MechanismUnavailable when shared_memory was demanded and cannot be.
Gate choose_mechanism(MechanismChoice choice, const Facts& facts);

}  // namespace play_launch::isolation
