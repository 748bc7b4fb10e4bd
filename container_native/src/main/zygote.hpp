#pragma once

#include "base/command_file.hpp"

namespace play_launch::container {

/// A zygote is a container that has been linked and does nothing more until spawn_guard asks for a
/// fork of it, which then is a container like one that was started anew: the dynamic linker's work
/// is done once, and while the supervisor still reads its configuration.
///
/// Every fork is a child of spawn_guard. Nothing of ROS runs before: what has been initialised once
/// does not survive a fork.
///
/// The socket is a SOCK_SEQPACKET whose other end the supervisor has; spawn_guard sends through it:
///   {numbers of the child's descriptors}, with the descriptors: a line to this very child, the
///   command (see Command), then those.
/// The child sends {its pid} through the line once it is like one after exec, and begins when
/// anything arrives there. At the end of the line it exits: closing the line cancels the fork. A
/// zygote that cannot fork closes the line.
///
/// Returns in each child, with what it has to do. The zygote itself never returns: it ends when the
/// socket does, or at once when it cannot fork here.
Command serve_as_zygote(int socket);

}  // namespace play_launch::container
