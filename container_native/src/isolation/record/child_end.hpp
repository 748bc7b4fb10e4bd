#pragma once

#include <sys/types.h>

namespace play_launch::isolation {

/// How a child ended.
struct ChildEnd {
  int error = 0;      // errno when there was no child at all; the rest is 0 then
  pid_t pid = 0;      // what it had; free to be used again by now
  int exit_code = 0;  // when it exited
  int signal = 0;     // when a signal ended it; else 0
  bool dumped_core = false;
  /// Its entry function came to its end, whatever the child then died of: its first thread did not
  /// die amidst something.
  bool returned = false;

  bool clean() const { return error == 0 && returned && signal == 0 && exit_code == 0; }
};

}  // namespace play_launch::isolation
