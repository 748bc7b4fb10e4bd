"""What this machine can do: facts are gathered, and judged by functions without I/O."""
