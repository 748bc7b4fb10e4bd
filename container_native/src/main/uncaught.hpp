#pragma once

namespace play_launch::container {

/// From now on, when an exception that no code of a node catches ends the process of the node, or
/// the container where nodes have none of their own, the log says whose callback threw what; then
/// the terminate handler that was set before is called. Once.
void name_nodes_that_throw();

}  // namespace play_launch::container
