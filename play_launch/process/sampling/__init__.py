"""Samples of processes, control groups and the machine: see docs/decisions/recording.md#samples."""
