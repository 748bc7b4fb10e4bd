#pragma once

#include "isolation/record/child_record.hpp"
#include "isolation/record/crash_slot.hpp"

namespace play_launch::isolation {

/// Runs program.run() in a child process on the calling thread, which must be a DonorThread's, and
/// returns when the child is dead and reaped. The child
/// - is killed when the container dies, and has the container's memory and file descriptors;
/// - writes its pid into the slot before anything else;
/// - has default signal actions, but for SIGPIPE as the container has it, and the handlers of
///   crash_handler.hpp; blocks nothing;
/// - ends alone when it calls exit();
/// - after a child on the same donor that did not return, can destroy condition variables in which
///   that one's threads died.
/// Its CPU time: clock_getcpuclockid(slot.pid). (pthread_getcpuclockid() only works within it.)
/// Resets `slot` first. Never throws, never allocates, and takes no lock.
ChildEnd run_in_child(ChildProgram& program, CrashSlot& slot,
                      const ChildOptions& options = {}) noexcept;

/// Sends a signal to the child that has this slot; never to another process, even when the child
/// dies meanwhile. False when no child lives, or the signal cannot be sent.
bool send_signal(CrashSlot& slot, int signal) noexcept;

}  // namespace play_launch::isolation
