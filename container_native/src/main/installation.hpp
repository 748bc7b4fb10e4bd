#pragma once

namespace play_launch::container {

/// Adds the prefix that this program is installed in to AMENT_PREFIX_PATH, behind the others: the
/// components installed beside the container are found also without a set-up environment.
/// Call it before there are threads.
void search_own_prefix();

}  // namespace play_launch::container
