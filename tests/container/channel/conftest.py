"""Fixtures of the tests of the control channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import play_launch_msgs.msg as msgs
import pytest
from blockbuster import blockbuster_ctx
from rclpy.serialization import serialize_message

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="session", autouse=True)
def _the_peer_is_loaded() -> None:
    """Load the type supports of the other side, which takes long and must not happen in a loop."""
    for name in dir(msgs):
        if isinstance(kind := getattr(msgs, name), type):
            serialize_message(kind())


@pytest.fixture(autouse=True)
def _loop_is_never_blocked() -> Iterator[None]:
    with blockbuster_ctx("play_launch"):
        yield
