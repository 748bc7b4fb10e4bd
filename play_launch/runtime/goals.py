"""Conversations with managed (lifecycle) nodes: their states are inputs, transitions effects."""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from typing import TYPE_CHECKING, Final

import anyio

from play_launch.runtime.sources import Source, Sources
from play_launch.supervisor.events import ManagedState
from play_launch.supervisor.goals import ManagedAction
from play_launch.supervisor.inputs import GoalReported, ManagedInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from anyio.abc import TaskGroup

    from play_launch.ros.access import RosAccess
    from play_launch.ros.managed_node import ManagedNodeClient
    from play_launch.supervisor.inputs import Input
    from play_launch.supervisor.world import Goal, World

_log = logging.getLogger(__name__)

_INPUT_OF_STATE: Final = {
    1: ManagedInput.IS_UNCONFIGURED,
    2: ManagedInput.IS_INACTIVE,
    3: ManagedInput.IS_ACTIVE,
    4: ManagedInput.IS_FINALIZED,
}
"""By the numbers of ``lifecycle_msgs/msg/State``; the others are on the way between these."""
_TRANSITIONS: Final = {
    ManagedAction.CONFIGURE: (1, ManagedInput.IS_INACTIVE),
    ManagedAction.ACTIVATE: (3, ManagedInput.IS_ACTIVE),
}
"""Numbers of ``lifecycle_msgs/msg/Transition``, and where they lead."""
_UNDER_WAY: Final = {
    ManagedState.CONFIGURING: ManagedAction.CONFIGURE,
    ManagedState.ACTIVATING: ManagedAction.ACTIVATE,
}
_CHECKS: Final = (1.0, 2.0, 4.0, 8.0)
"""Seconds between checks of an idle node. A state that it entered before DDS had
connected its topic with us is never reported; that takes up to 3.3 s after its services exist,
more on a busy machine."""


class _Conversation:
    """With one node instance."""

    def __init__(self, instance: int) -> None:
        self.instance = instance
        self.to_do: asyncio.Queue[ManagedAction] = asyncio.Queue()
        self.source = Source()


class Conversations:
    """Belongs to the thread of the event loop."""

    def __init__(
        self, post: Callable[[Input], None], ros: Callable[[], RosAccess], world: World
    ) -> None:
        """``ros`` is called when a managed node is talked to first."""
        self._post = post
        self._ros = ros
        self._world = world
        self._sources = Sources(lambda error: _log.error("%s", error, exc_info=error))
        self._open: dict[str, _Conversation] = {}

    def run_in(self, tasks: TaskGroup) -> None:
        """Run them in ``tasks``."""
        self._sources.run_in(tasks)

    def begin(self, unit: str, instance: int) -> None:
        """Begin a conversation with a node."""
        self.end(unit)
        talk = self._open[unit] = _Conversation(instance)
        talk.source = self._sources.begin(partial(self._converse, unit, talk))

    def transit(self, unit: str, instance: int, action: str) -> None:
        """Request a transition."""
        talk = self._open.get(unit)
        if talk is not None and talk.instance == instance:
            talk.to_do.put_nowait(ManagedAction(action))

    def end(self, unit: str) -> None:
        """End the conversation with a node, if there is one."""
        talk = self._open.pop(unit, None)
        if talk is not None:
            talk.source.cancel()

    def _report(self, unit: str, talk: _Conversation, said: ManagedInput, reason: str = "") -> None:
        if self._open.get(unit) is talk:
            self._post(GoalReported(unit, talk.instance, said, reason))

    async def _converse(self, unit: str, talk: _Conversation) -> None:
        """Drive one node instance; cancelled when the node exits.

        An exception is a failure of this node, unless it is not managed any more.
        """
        goal = self._world.goals[unit]
        try:
            await self._talk(unit, goal, talk)
        except Exception as error:  # noqa: BLE001 - the others go on
            _log.warning("%s cannot be talked to: %s", goal.config.name, error)
            self._report(unit, talk, ManagedInput.REFUSED, str(error))

    async def _talk(self, unit: str, goal: Goal, talk: _Conversation) -> None:
        """Request its state, and then one transition after the other."""
        known: ManagedInput | None = None

        def accept(state: int) -> None:
            nonlocal known
            said = _INPUT_OF_STATE.get(state)
            if said is not None:
                known = said
                now = self._world.goals.get(unit, goal).state
                under_way = _UNDER_WAY.get(now)
                how = f"its transition {under_way} led to" if under_way else "it is in"
                reason = f"{how} the state {said.removeprefix('is_')}"
                self._report(unit, talk, said, reason)

        def check(state: int) -> None:
            # A transition that failed leads back to where it began, which is no news.
            if _INPUT_OF_STATE.get(state) is not known:
                accept(state)

        name, limit = goal.config.name, goal.config.timeout
        async with self._ros().managed_node(name, accept) as client:
            with anyio.move_on_after(limit) as asking:
                accept(await client.state())
            if asking.cancelled_caught:
                reason = (
                    "its lifecycle services did not answer"
                    if client.is_offered
                    else f"the service {name}/get_state was not available"
                )
                reason = f"{reason} within {limit:g} s"
                self._report(unit, talk, ManagedInput.OVERDUE, reason)
            while True:
                action = await _next_action(talk, client, check, limit)
                said, reason = await _change(client, action, limit)
                if said is _TRANSITIONS[action][1]:
                    known = said
                self._report(unit, talk, said, reason)


async def _next_action(
    talk: _Conversation, client: ManagedNodeClient, on_state: Callable[[int], None], limit: float
) -> ManagedAction:
    """Give the next action; check the state of an idle node a few times."""
    for pause in _CHECKS:
        with anyio.move_on_after(pause):
            return await talk.to_do.get()
        with anyio.move_on_after(limit):
            on_state(await client.state())
    return await talk.to_do.get()


async def _change(
    client: ManagedNodeClient, action: ManagedAction, limit: float
) -> tuple[ManagedInput, str]:
    """Request a transition and give it ``limit`` seconds; give its result, and why it failed."""
    transition, leads_to = _TRANSITIONS[action]
    with anyio.move_on_after(limit):
        if await client.change(transition):
            return leads_to, ""
        return ManagedInput.REFUSED, f"its transition {action} failed"
    return ManagedInput.OVERDUE, f"its transition {action} took longer than {limit:g} s"
