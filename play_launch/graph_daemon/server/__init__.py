"""The daemon's process: the node that looks at the graph, and what answers clients."""
