"""A node that has to be in a control group and is not let in does not run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent

from tests.support.isolated import MODES, start, survives

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer

GONE = "/no/such/group"
LOAD_FAILED = ComponentEvent.LOAD_FAILED


@pytest.mark.parametrize("mode", MODES)
def test_a_node_that_is_kept_out(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode)
    with survives(container):
        # Without the word, it runs where it is.
        container.loaded("Talker", node_name="anywhere", resources=[f"cgroup {GONE}"])
        attempt = container.load("Talker", resources=[f"required_cgroup {GONE}"])
        failed = container.event(LOAD_FAILED, attempt=attempt)
        reason = "the kernel did not let it into its control group, which is required"
        assert reason in failed.error_message
