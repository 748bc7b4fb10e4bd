// Defines ptrace() for the whole program. Some libraries have themselves traced by their parent to
// keep debuggers away (PTRACE_TRACEME). The parent does not know of it: the donor of a node would
// take the first stop for the end, and go on, on the stack that both have; the guard of a session
// would never resume it. So that does nothing here, and succeeds. What a node forks is free to do
// it, as debuggers do before they start a program.

#include <sys/ptrace.h>
#include <unistd.h>

#include <cstdarg>

#include "base/next_function.hpp"
#include "base/protected_descriptors.hpp"
#include "isolation/record/child_record.hpp"

namespace {

const play_launch::NextFunction<"ptrace", long(__ptrace_request, ...)> next_ptrace;

/// Of a process that is the container, or a node of it.
bool is_ours() noexcept {
  return play_launch::isolation::current_child() != nullptr || play_launch::protects_descriptors();
}

}  // namespace

extern "C" [[gnu::visibility("default")]] long ptrace(__ptrace_request request, ...) noexcept {
  if (request == PTRACE_TRACEME && is_ours()) {
    return 0;
  }
  va_list list;
  va_start(list, request);
  const auto pid = va_arg(list, pid_t);
  void* const address = va_arg(list, void*);
  void* const data = va_arg(list, void*);
  va_end(list);
  return next_ptrace.get()(request, pid, address, data);
}
