#pragma once

namespace play_launch::guard {

/// Serves one supervisor until its end of the socket closes, then leaves nothing behind.
///
/// This process is the parent of everything that the supervisor starts, and the subreaper of all
/// that comes of it: a process that forks twice, calls setsid(2) or forbids its death with its
/// parent becomes its child at last. So it outlives a supervisor that is killed, finds all of it,
/// and kills it. Containers get `kOrphanGrace` first, as they leave by themselves when their
/// channel ends.
///
/// The socket is a SOCK_SEQPACKET; each request has one answer, in the order of the requests, both
/// native-endian 32-bit integers:
///   spawn   {1, exits with the supervisor, number n of descriptors, their numbers in the child},
///           with the descriptors: a file with the command (see Command), the end of a pipe, then
///           those n.
///           -> {pid, or -errno; 0; 0}
///           Nothing is executed before a byte is in the pipe: the supervisor has the answer then.
///           When the pipe ends without one, the process ends.
///   status  {2, pid} -> {1: ended, 0: runs, or -errno; code, status as in siginfo_t}
///   reap    {3, pid} -> the same, and the zombie is gone
///   farewell {4}: the end of the socket that follows is not that of the supervisor. No answer.
///   group   {5}, with a descriptor: the folder of the session's control group. When the supervisor
///           has died, it is removed with those below it and all that is in them. No answer.
///   forget  {6, pid}: nothing asks any more about a process that was given up. No answer.
///
/// When the supervisor has died, `last_command` is started after all of that, unless it is null:
/// what it does for the dead is done by no other process until the next start.
///
/// Returns the exit status.
int guard_session(int socket, char* const* last_command);

}  // namespace play_launch::guard
