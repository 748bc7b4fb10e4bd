"""An exception that no code of a node catches ends the process where it is thrown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.support.exceptions import CALLBACKS, crasher_ends_its_container, crasher_is_reported
from tests.support.isolated import MODES, start_isolated, survives
from tests.support.ros import Probe

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("callback", CALLBACKS)
def test_the_backtrace_names_who_threw(spawn: StartContainer, mode: str, callback: str) -> None:
    container = start_isolated(spawn, mode)
    after, provoke = CALLBACKS[callback]
    with survives(container), Probe() as probe:
        crasher = container.loaded("Crasher", parameters={"how": "deep_exception", "after": after})
        if provoke is not None:
            provoke(probe)
        crasher_is_reported(container, crasher.unique_id)


@pytest.mark.parametrize("mode", [(), ("--use_multi_threaded_executor",)], ids=["standard", "mt"])
def test_a_shared_container_names_the_node_that_ends_it(
    spawn: StartContainer, mode: tuple[str, ...]
) -> None:
    container = spawn(*mode)
    container.load("Crasher", parameters={"how": "deep_exception", "after": 0.0})
    crasher_ends_its_container(container)
