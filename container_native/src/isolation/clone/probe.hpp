#pragma once

namespace play_launch::isolation {

/// Result of a process that was made to try the following out.
struct Probe {
  /// It made a child that shares its memory, and waited for its end.
  bool shares_memory = false;
  /// errno, when it could not even make one; else 0.
  int clone_error = 0;
  /// It lived on when such a child died of a signal that dumps core. Linux before 5.16 ends all
  /// processes that share the memory then.
  bool survives_crash = false;
  /// It could be waited for by a descriptor (pidfd_open, Linux 5.4).
  bool waits_by_descriptor = false;
  /// 0, or the errno of reading what it sleeps in, which DeadLockSearch needs of every node:
  /// /proc/<pid>/task/<tid>/syscall.
  int syscall_error = 0;
};

/// Forks that process, and waits for it: milliseconds, at most seconds. No core is written.
/// prepare_clone() must have been called. Any thread, but not in a child.
Probe probe_machine() noexcept;

}  // namespace play_launch::isolation
