"""As much of rclpy as a daemon without a graph needs: whether a signal has ended it."""

import signal

_ended = False


def init() -> None:
    """Take SIGTERM, as rclpy does."""
    signal.signal(signal.SIGTERM, _end)


def ok() -> bool:
    return not _ended


def _end(_signal: int, _frame: object) -> None:
    global _ended  # noqa: PLW0603
    _ended = True
