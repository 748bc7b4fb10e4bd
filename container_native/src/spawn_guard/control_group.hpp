#pragma once

#include "base/unique_fd.hpp"

namespace play_launch::guard {

/// Removes a control group and those below it with whatever is in them, as far as that dies within
/// some seconds. `folder` is open for reading.
void remove_group(const UniqueFd& folder);

}  // namespace play_launch::guard
