// Defines close(), close_range(), closefrom(), dup2() and dup3() for the whole program, as
// exit_guard.cpp does with exit(). All nodes share the container's table of descriptors; in a
// child, code of a node cannot close or replace what the container needs
// (protected_descriptors.hpp). Such an attempt fails with EBADF, as with a number that is not open;
// a range that includes such descriptors is left alone as a whole, and the call says that it has
// worked: programs that call it mean to close what they do not know, which here is their
// neighbours', and on an error many go on number by number. The middleware
// (early_code.hpp) may close what it likes: its descriptors are opened and closed by whatever
// thread comes along.

#include <linux/close_range.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>

#include "base/early_code.hpp"
#include "base/next_function.hpp"
#include "base/protected_descriptors.hpp"
#include "isolation/record/child_record.hpp"

namespace {

using namespace play_launch;
using isolation::ChildRecord;
using isolation::CrashSlot;

// The C library's, for what differs from the system call: close() is a place where threads can be
// cancelled.
const NextFunction<"close", int(int)> next_close;
const NextFunction<"closefrom", void(int)> next_closefrom;
const NextFunction<"dup2", int(int, int)> next_dup2;

void note_refusal(const ChildRecord& child, const char* call, int fd) noexcept {
  CrashSlot& slot = *child.slot;
  int none = -1;
  if (slot.refused_descriptor.compare_exchange_strong(none, fd)) {
    slot.refused_call = call;
    child.program->noted();
  }
}

/// Whether `caller` may close or replace it; if so, that is about to happen.
bool may_close(int fd, const char* call, const void* caller) noexcept {
  if (!may_be_protected(fd)) {
    return true;
  }
  const ChildRecord* const child = isolation::current_child();
  if (child == nullptr && !protects_descriptors()) {
    return true;  // a process that was forked, with a table of its own
  }
  if (child != nullptr && !is_early_code_below_nodes(caller) && is_protected(fd)) {
    note_refusal(*child, call, fd);
    errno = EBADF;
    return false;
  }
  release_protection(fd);
  return true;
}

/// The same for a range.
bool may_close_range(unsigned first, unsigned last, const char* call, const void* caller) noexcept {
  const ChildRecord* const child = isolation::current_child();
  if (child == nullptr || is_early_code_below_nodes(caller) || !is_any_protected(first, last)) {
    return true;
  }
  note_refusal(*child, call, static_cast<int>(first));
  return false;
}

}  // namespace

extern "C" {

[[gnu::visibility("default")]] int close(int fd) {
  if (!may_close(fd, "close", __builtin_return_address(0))) {
    return -1;
  }
  return next_close.get()(fd);
}

[[gnu::visibility("default")]] int close_range(unsigned first, unsigned last, int flags) noexcept {
  const bool closes = (flags & static_cast<int>(CLOSE_RANGE_CLOEXEC)) == 0;
  if (closes && !may_close_range(first, last, "close_range", __builtin_return_address(0))) {
    return 0;
  }
  return static_cast<int>(::syscall(SYS_close_range, first, last, flags));
}

[[gnu::visibility("default")]] void closefrom(int first) noexcept {
  const auto from = static_cast<unsigned>(first < 0 ? 0 : first);
  if (may_close_range(from, ~0U, "closefrom", __builtin_return_address(0))) {
    next_closefrom.get()(first);
  }
}

[[gnu::visibility("default")]] int dup2(int from, int to) noexcept {
  if (from != to && !may_close(to, "dup2", __builtin_return_address(0))) {
    return -1;
  }
  return next_dup2.get()(from, to);
}

[[gnu::visibility("default")]] int dup3(int from, int to, int flags) noexcept {
  if (from != to && !may_close(to, "dup3", __builtin_return_address(0))) {
    return -1;
  }
  return static_cast<int>(::syscall(SYS_dup3, from, to, flags));
}

}  // extern "C"
