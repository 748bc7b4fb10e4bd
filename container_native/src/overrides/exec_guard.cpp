// Defines execve() and its relatives for the whole program, as exit_guard.cpp does with exit(). In
// a child they end it: the program that would take its place is no node any more, has none of its
// memory, and unsupervised. The container reports which program that was. What cannot
// be executed fails as always. A process that a node forked is no child, and does as it likes.

#include <alloca.h>
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdarg>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <string_view>

#include "base/next_function.hpp"
#include "isolation/crash/crash_handler.hpp"
#include "isolation/record/child_record.hpp"
#include "overrides/exit_guard.hpp"

namespace {

using namespace play_launch::isolation;

using Arguments = char* const*;
using Path = std::array<char, 256>;

const play_launch::NextFunction<"execve", int(const char*, Arguments, Arguments)> next_execve;
const play_launch::NextFunction<"execvpe", int(const char*, Arguments, Arguments)> next_execvpe;
const play_launch::NextFunction<"fexecve", int(int, Arguments, Arguments)> next_fexecve;
const play_launch::NextFunction<"execveat", int(int, const char*, Arguments, Arguments, int)>
    next_execveat;

[[noreturn]] void end_for(ChildRecord& child, const char* program) noexcept {
  claim_end(child);
  const std::string_view text = program;
  Path& noted = child.slot->report.other_program;
  std::copy_n(text.data(), std::min(text.size(), noted.size() - 1), noted.data());
  end_child(child, 0, "execve()");
}

/// Ends the child that calls this, if there is one and the program can be executed.
void end_if_child(int folder, const char* program, int flags) noexcept {
  ChildRecord* const child = current_child();
  if (child == nullptr || ::faccessat(folder, program, X_OK, flags) != 0) {
    return;
  }
  end_for(*child, program);
}

void end_if_child(int fd) noexcept {
  ChildRecord* const child = current_child();
  Path link{};
  Path program{};
  std::snprintf(link.data(), link.size(), "/proc/self/fd/%d", fd);
  if (child != nullptr && ::readlink(link.data(), program.data(), program.size() - 1) > 0) {
    end_for(*child, program.data());
  }
}

/// With the search in PATH.
void end_if_child_finds(const char* program) noexcept {
  const std::string_view name = program;
  if (current_child() == nullptr || name.empty()) {
    return;
  }
  if (name.find('/') != std::string_view::npos) {
    end_if_child(AT_FDCWD, program, 0);
    return;
  }
  const char* const variable = std::getenv("PATH");
  std::string_view folders = variable == nullptr ? "/bin:/usr/bin" : variable;
  while (true) {
    const std::string_view folder = folders.substr(0, folders.find(':'));
    Path path{};
    const int length = std::snprintf(path.data(), path.size(), "%.*s/%s",
                                     static_cast<int>(folder.size()), folder.data(), program);
    if (length > 0 && static_cast<std::size_t>(length) < path.size()) {
      end_if_child(AT_FDCWD, folder.empty() ? program : path.data(), 0);
    }
    if (folder.size() == folders.size()) {
      return;
    }
    folders.remove_prefix(folder.size() + 1);
  }
}

}  // namespace

// The arguments from `first` on, up to the null pointer, as an array on the caller's stack.
#define PLAY_LAUNCH_COLLECT(array, list, first)                                  \
  std::size_t count = 1;                                                         \
  va_list list;                                                                  \
  va_start(list, first);                                                         \
  while (va_arg(list, const char*) != nullptr) {                                 \
    ++count;                                                                     \
  }                                                                              \
  va_end(list);                                                                  \
  auto** const array = static_cast<char**>(alloca((count + 1) * sizeof(char*))); \
  array[0] = const_cast<char*>(first);                                           \
  va_start(list, first);                                                         \
  for (std::size_t i = 1; i <= count; ++i) {                                     \
    array[i] = va_arg(list, char*);                                              \
  }

extern "C" {

[[gnu::visibility("default")]] int execve(const char* program, Arguments arguments,
                                          Arguments environment) noexcept {
  end_if_child(AT_FDCWD, program, 0);
  return next_execve.get()(program, arguments, environment);
}

[[gnu::visibility("default")]] int execv(const char* program, Arguments arguments) noexcept {
  return execve(program, arguments, environ);
}

[[gnu::visibility("default")]] int execvpe(const char* program, Arguments arguments,
                                           Arguments environment) noexcept {
  end_if_child_finds(program);
  return next_execvpe.get()(program, arguments, environment);
}

[[gnu::visibility("default")]] int execvp(const char* program, Arguments arguments) noexcept {
  return execvpe(program, arguments, environ);
}

[[gnu::visibility("default")]] int execl(const char* program, const char* first, ...) noexcept {
  PLAY_LAUNCH_COLLECT(arguments, list, first)
  va_end(list);
  return execve(program, arguments, environ);
}

[[gnu::visibility("default")]] int execlp(const char* program, const char* first, ...) noexcept {
  PLAY_LAUNCH_COLLECT(arguments, list, first)
  va_end(list);
  return execvpe(program, arguments, environ);
}

[[gnu::visibility("default")]] int execle(const char* program, const char* first, ...) noexcept {
  PLAY_LAUNCH_COLLECT(arguments, list, first)
  auto* const environment = va_arg(list, char* const*);
  va_end(list);
  return execve(program, arguments, environment);
}

[[gnu::visibility("default")]] int fexecve(int fd, Arguments arguments,
                                           Arguments environment) noexcept {
  end_if_child(fd);
  return next_fexecve.get()(fd, arguments, environment);
}

[[gnu::visibility("default")]] int execveat(int folder, const char* program, Arguments arguments,
                                            Arguments environment, int flags) noexcept {
  if ((flags & AT_EMPTY_PATH) != 0 && program[0] == '\0') {
    end_if_child(folder);
  } else {
    end_if_child(folder, program, 0);
  }
  return next_execveat.get()(folder, program, arguments, environment, flags);
}

}  // extern "C"
