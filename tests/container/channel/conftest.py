"""Fixtures of the tests of the control channel."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from blockbuster import blockbuster_ctx

from play_launch.container.cdr.messages import CONTROL_HELLO


@pytest.fixture(scope="session", autouse=True)
def _definitions_are_read() -> None:
    """Read the definitions of our messages, all at once, before a loop runs."""
    assert CONTROL_HELLO.types


@pytest.fixture(autouse=True)
def _loop_is_never_blocked() -> Iterator[None]:
    with blockbuster_ctx("play_launch"):
        yield
