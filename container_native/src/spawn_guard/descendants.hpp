#pragma once

#include <sys/types.h>

#include <set>
#include <vector>

#include "base/unique_fd.hpp"

namespace play_launch::guard {

/// The children of the calling thread, those that have ended and were not waited for among them.
std::vector<pid_t> children();

/// Sends SIGKILL to what is below this process, at any depth, but for the children in `spared` and
/// what is below those. Complete because this process is a subreaper: whatever of it is orphaned
/// becomes its child.
void kill_descendants(const std::set<pid_t>& spared);

/// Removes a control group and those below it with whatever is in them, as far as that dies within
/// some seconds. `folder` is open for reading.
void remove_group(const UniqueFd& folder);

}  // namespace play_launch::guard
