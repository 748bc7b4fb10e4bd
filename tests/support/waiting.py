"""Waiting for what has no event to wait for."""

from __future__ import annotations

import time
from collections.abc import Callable

LIMIT = 60.0


def until(done: Callable[[], bool], what: str, limit: float = LIMIT) -> None:
    """Look again and again until ``done``; AssertionError naming ``what`` after ``limit`` s."""
    deadline = time.monotonic() + limit
    while not done():
        assert time.monotonic() < deadline, f"waited {limit} s for {what}"
        time.sleep(0.02)
