"""One container: its process, its control channel and, mirrored, its nodes."""
