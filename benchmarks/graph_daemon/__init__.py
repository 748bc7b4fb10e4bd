"""The graph daemon beside ros2cli's own: see `benchmarks.graph_daemon.__main__`."""
