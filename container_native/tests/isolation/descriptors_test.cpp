// Which code may close the container's descriptors.

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/wait.h>

#include <cerrno>

#include "base/early_code.hpp"
#include "base/protected_descriptors.hpp"
#include "harness.hpp"
#include "rcl_stand_in.hpp"

namespace {

using namespace isolation_test;
using namespace play_launch;

int open_nothing() {
  const int fd = ::open("/dev/null", O_RDWR | O_CLOEXEC);
  CHECK(fd >= 0);
  return fd;
}

bool is_open(int fd) { return ::fcntl(fd, F_GETFD) >= 0; }

/// Runs in a child and expects that it returns nothing worse than 0.
void in_child(Outcome& outcome, const std::function<bool()>& body) {
  run(outcome, [&](Program&) { return body() ? 0 : 1; });
  CHECK(outcome.end.clean() && outcome.end.exit_code == 0);
}

void test_moving() {
  const int low = open_nothing();
  const int high = move_out_of_reach(low);
  CHECK(high >= 512 && is_open(high) && !is_open(low) && is_protected(high));
  CHECK(::fcntl(high, F_GETFD) == FD_CLOEXEC);
  CHECK(::close(high) == 0 && !is_open(high) && !is_protected(high));
}

void test_refusal() {
  const int ours = move_out_of_reach(open_nothing());
  const int theirs = open_nothing();
  Outcome outcome;
  in_child(outcome, [&] {
    errno = 0;
    const bool refused = ::close(ours) == -1 && errno == EBADF && ::dup2(theirs, ours) == -1 &&
                         errno == EBADF && ::dup3(theirs, ours, O_CLOEXEC) == -1;
    return refused && ::dup2(ours, ours) == ours && ::close(theirs) == 0;
  });
  CHECK(is_open(ours) && !is_open(theirs));
  CHECK(outcome.slot.refused_descriptor == ours);
  CHECK(contains(outcome.text(), "called close(" + std::to_string(ours) + ")"));
  CHECK(::close(ours) == 0);
}

void test_ranges() {
  const int theirs = open_nothing();
  const int ours = move_out_of_reach(open_nothing());
  Outcome outcome;
  in_child(outcome, [&] {
    ::closefrom(3);
    return ::close_range(3, ~0U, 0) == 0;
  });
  CHECK(is_open(ours) && is_open(theirs));
  CHECK(contains(outcome.text(), "called closefrom(3, …)"));
  in_child(outcome, [&] {
    const auto number = static_cast<unsigned>(theirs);
    return ::close_range(number, number, 0) == 0 && ::close_range(3, ~0U, CLOSE_RANGE_CLOEXEC) == 0;
  });
  CHECK(is_open(ours) && !is_open(theirs));
  CHECK(outcome.slot.refused_call == nullptr);
  CHECK(::close(ours) == 0);
}

/// A number that was closed in an invisible way, and used again.
void test_other_file() {
  const int ours = move_out_of_reach(open_nothing());
  int ends[2];
  CHECK(::pipe2(ends, O_CLOEXEC) == 0);
  CHECK(::syscall(SYS_dup3, ends[0], ours, O_CLOEXEC) == ours);
  CHECK(!is_protected(ours));
  Outcome outcome;
  in_child(outcome, [&] { return ::close(ours) == 0; });
  CHECK(!is_open(ours));
  ::close(ends[0]);
  ::close(ends[1]);
}

/// They have tables of their own, and close what they like, without changing what is protected.
void test_forked_processes() {
  const int ours = move_out_of_reach(open_nothing());
  Outcome outcome;
  for (const bool shares_memory : {false, true}) {
    in_child(outcome, [&] {
      const pid_t pid = shares_memory ? ::vfork() : ::fork();
      if (pid == 0) {
        ::_exit(::close(ours) == 0 && ::close_range(3, ~0U, 0) == 0 ? 0 : 1);
      }
      int status = -1;
      return ::waitpid(pid, &status, 0) == pid && status == 0;
    });
    CHECK(is_open(ours) && is_protected(ours) && outcome.slot.refused_call == nullptr);
  }
  CHECK(::close(ours) == 0);
}

void test_everything_open() {
  const int before = open_nothing();
  protect_open_descriptors();
  const int after = open_nothing();
  CHECK(is_protected(STDERR_FILENO) && is_protected(before) && !is_protected(after));
  CHECK(is_any_protected(3, ~0U) && !is_any_protected(2000, 4000));
  CHECK(!is_protected(-1) && !is_protected(1'000'000));
  ::close(before);
  ::close(after);
}

/// Only libraries that do not call code of nodes count.
void test_early_code() {
  const int ours = move_out_of_reach(open_nothing());
  note_early_code();
  CHECK(!is_early_code_below_nodes(reinterpret_cast<const void*>(&test_early_code)));
  CHECK(!is_early_code_below_nodes(::dlsym(RTLD_DEFAULT, "getpid")) &&
        !is_early_code_below_nodes(&ours));
  Outcome outcome;
  in_child(outcome, [&] { return ::close(ours) == -1 && stand_in::close_file(ours) == 0; });
  CHECK(!is_open(ours) && !is_protected(ours));
}

}  // namespace

int main() {
  prepare_crash_handling();
  test_moving();
  test_refusal();
  test_ranges();
  test_other_file();
  test_forked_processes();
  test_everything_open();
  test_early_code();
  return 0;
}
