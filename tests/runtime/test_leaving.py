"""What was asked to end and does not in time, or ends while another program acts on it."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator
from typing import Any

import pytest

from play_launch.config.node_key import NodeKey
from play_launch.control.actions import ActionLog, Actions
from play_launch.control.feed import Feed
from play_launch.control.messages import ActionRequest, Caller, SignalRequest
from play_launch.control.protocol import MEMBER_ACTIONS, NODE_ACTIONS, OperationError
from play_launch.supervisor.expectations import Expectations
from play_launch.supervisor.plan import PlanAction

from .fakes import FakeContainer, FakeLauncher, container, process, system
from .running import Running, running

BEFORE = system(container("box", "stays", "goes"), process("p"))
AFTER = system(container("box", "stays"))


class Slow(FakeContainer):
    """Its nodes take a minute to leave."""

    def on_unload(self, unique_id: int) -> None:
        asyncio.get_running_loop().call_later(60, super().on_unload, unique_id)

    def on_shutdown(self) -> None:
        self.held.clear()
        super().on_shutdown()


async def taken_out_too_slowly(sys: Running) -> None:
    await sys.until_loaded(2)
    sys.launcher.processes["/p"][0].lingers = 60.0
    applied = await sys.operated.applying.apply(AFTER, limit=1)
    assert [each.reason for each in applied.outcomes] == ["it takes longer than 1 s"] * 2
    left = sys.operated.applying.plan(AFTER).steps
    assert {(step.name, step.action) for step in left} == {
        ("/box:/goes", PlanAction.REMOVE),
        ("/p", PlanAction.REMOVE),
    }


@pytest.mark.parametrize("pause", [0, 100], ids=["on its way", "gone by then"])
async def test_what_left_too_slowly_returns_with_the_configuration_that_has_it(
    pause: float,
) -> None:
    async with running(BEFORE, FakeLauncher({"/box": [Slow]})) as sys:
        await taken_out_too_slowly(sys)
        await asyncio.sleep(pause)
        back = sys.operated.applying.plan(BEFORE).steps
        assert {(step.name, step.action) for step in back} == {
            ("/box:/goes", PlanAction.LOAD),
            ("/p", PlanAction.START),
        }
        assert (await sys.operated.applying.apply(BEFORE, limit=200)).succeeded
        assert sys.view.loaded == 2
        assert sys.view.is_complete
        assert not sys.operated.applying.plan(BEFORE).steps


async def test_a_node_on_its_way_out_is_not_loaded_again_by_hand() -> None:
    async with running(BEFORE, FakeLauncher({"/box": [Slow]})) as sys:
        await taken_out_too_slowly(sys)
        sys.operated.start(NodeKey("/box", "/goes"))
        await asyncio.sleep(100)
        assert [key.name for key in sys.view.containers["/box"].nodes] == ["/stays"]


class Late(ActionLog):
    """Has all of it taken out between the choice of names and the action."""

    def __init__(self, sys: Running) -> None:
        super().__init__(sys.publisher)
        self._sys = sys

    @contextlib.asynccontextmanager
    async def recorded(self, *asked: Any) -> AsyncIterator[None]:
        await self._sys.operated.applying.apply(system(process("other")))
        async with super().recorded(*asked):
            yield


@pytest.mark.parametrize("action", [*MEMBER_ACTIONS, *NODE_ACTIONS, "signal"])
@pytest.mark.parametrize("name", ["/p", "/box", "/stays"])
async def test_what_is_taken_out_meanwhile_is_reported_as_such(action: str, name: str) -> None:
    is_node = name == "/stays"
    for_nodes = action in NODE_ACTIONS
    if action != "signal" and is_node is not for_nodes:
        return

    async with running(BEFORE, FakeLauncher()) as sys:
        await sys.until_loaded(2)
        actions = Actions(sys.operated, sys.publisher, Feed(), Late(sys), Expectations({}))
        request = ActionRequest(names=(name,))
        if action == "signal":
            request = SignalRequest(names=(name,), signal="USR1")
        with pytest.raises(OperationError, match="taken out of the system"):
            await actions.act(action, request, Caller(os.getpid(), 0))
