"""An exception that no code of an rclcpp node catches ends the process where it is thrown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.rclcpp.modes import start
from tests.support.exceptions import CALLBACKS, crasher_ends_its_container, crasher_is_reported
from tests.support.isolated import MODES, survives

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer
    from tests.support.ros import Probe


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("callback", CALLBACKS)
def test_the_backtrace_names_who_threw(
    spawn: StartContainer, components: str, mode: str, callback: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    after, provoke = CALLBACKS[callback]
    with survives(container):
        crasher = container.loaded(
            "Crasher", package=components, parameters={"how": "deep_exception", "after": after}
        )
        if provoke is not None:
            provoke(probe)
        crasher_is_reported(container, crasher.unique_id)


@pytest.mark.parametrize("mode", ["standard", "mt"])
def test_a_shared_container_names_the_node_that_ends_it(
    spawn: StartContainer, components: str, mode: str
) -> None:
    container = start(spawn, mode)
    container.load(
        "Crasher", package=components, parameters={"how": "deep_exception", "after": 0.0}
    )
    crasher_ends_its_container(container)
