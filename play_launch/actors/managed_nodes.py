"""Brings managed nodes where ``autostart`` says, beside their members; a sink of events.

What follows from what is decided by :mod:`play_launch.core.managed`.
"""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from typing import TYPE_CHECKING, Final, assert_never

import anyio
from msgspec import Struct, field

from play_launch.actors.sources import Source, Sources
from play_launch.core.events import (
    REPORTED_LOGGER,
    ManagedNodeChanged,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
)
from play_launch.core.managed import ManagedAction, ManagedInput, ManagedState, step
from play_launch.core.order import Look, Standing

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractAsyncContextManager

    from anyio.abc import TaskGroup

    from play_launch.actors.ports import ManagedNode
    from play_launch.actors.publisher import Publisher
    from play_launch.config.model import ManagedConfig
    from play_launch.core.events import RunEvent
    from play_launch.core.view import SystemView

    OpenClient = Callable[[str, Callable[[int], None]], AbstractAsyncContextManager[ManagedNode]]

_log = logging.getLogger(__name__)
_reported = logging.getLogger(REPORTED_LOGGER)

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
_LOOKS_AGAIN: Final = (1.0, 2.0, 4.0, 8.0)
"""Seconds between looks at a node that is left to itself. A state that it entered before DDS had
connected its topic with us is never heard of; that takes up to 3.3 s after its services are there,
more on a busy machine."""
_GONE: Final = frozenset(
    {
        NodeState.CRASHED,
        NodeState.LOST,
        NodeState.UNLOADING,
        NodeState.UNLOADED,
        NodeState.GAVE_UP,
        NodeState.REQUESTED,
    }
)


class _Managed(Struct):
    """One of them."""

    config: ManagedConfig
    state: ManagedState = ManagedState.ABSENT
    reason: str = ""
    """Why it failed; else empty."""
    task: Source | None = None
    """Drives the present node to its goal."""
    to_do: asyncio.Queue[ManagedAction] = field(default_factory=asyncio.Queue)


class ManagedNodes:
    """Belongs to the thread of the event loop."""

    def __init__(
        self,
        publisher: Publisher,
        on_change: Callable[[], None],
        open_client: Callable[
            [str, Callable[[int], None]], AbstractAsyncContextManager[ManagedNode]
        ],
    ) -> None:
        """Know no node yet; ``open_client`` gets a full name, and who hears states.

        ``on_change`` is called when one of them is in another state.
        """
        self._nodes: dict[str, _Managed] = {}
        self._publisher = publisher
        self._on_change = on_change
        self._open_client = open_client
        self._sources = Sources(lambda error: _log.error("%s", error, exc_info=error))

    def use(self, configs: Mapping[str, ManagedConfig]) -> None:
        """Take the managed nodes by unit; one that is there and is to go further does so."""
        for unit in self._nodes.keys() - configs.keys():
            self._apply(unit, ManagedInput.GONE)
            del self._nodes[unit]
        for unit, config in configs.items():
            known = self._nodes.get(unit)
            if known is not None and known.config == config:
                continue
            if known is None:
                self._nodes[unit] = _Managed(config)
            else:
                known.config = config
            if self._is_up(unit):
                self._apply(unit, ManagedInput.UP)

    def look(self, unit: str) -> Look:
        """Say whether a managed node is active."""
        node = self._nodes[unit]
        if node.state is ManagedState.ACTIVE:
            return Look(Standing.HOLDS)
        if node.state is ManagedState.FAILED:
            return Look(Standing.NEVER, node.reason)
        return Look(Standing.OPEN)

    def _is_up(self, unit: str) -> bool:
        view = self._publisher.view
        if unit in view.processes:
            return bool(view.processes[unit].pid)
        nodes = (
            each for container in view.containers.values() for each in container.nodes.values()
        )
        return any(str(each.key) == unit and each.state is NodeState.LOADED for each in nodes)

    def run_in(self, tasks: TaskGroup) -> None:
        """Drive the nodes in ``tasks`` from now on."""
        self._sources.run_in(tasks)

    def publish(self, event: RunEvent, _before: SystemView, _after: SystemView) -> None:
        """See whether one of them comes or goes."""
        match event:
            case NodeStateChanged():
                unit, is_up = str(event.key), event.state is NodeState.LOADED
                is_gone = event.state in _GONE
            case ProcessEvent():
                unit, is_up = event.name, event.kind is ProcessEventKind.STARTED
                is_gone = event.kind is ProcessEventKind.EXITED
            case _:
                return
        node = self._nodes.get(unit)
        if node is None:
            return
        # A state may be published again while it lasts.
        if is_up and node.task is None:
            self._apply(unit, ManagedInput.UP)
        elif is_gone:
            self._apply(unit, ManagedInput.GONE)

    def _apply(self, unit: str, said: ManagedInput, reason: str = "") -> None:
        node = self._nodes[unit]
        before = node.state
        node.state, actions = step(before, said, node.config.autostart)
        node.reason = reason if node.state is ManagedState.FAILED else ""
        if node.state is not before:
            if node.config.autostart is not None:
                self._publisher.publish(
                    ManagedNodeChanged(
                        stamp_ns=self._publisher.stamp_ns(),
                        unit=unit,
                        node=node.config.name,
                        state=node.state,
                        reason=node.reason,
                    )
                )
            self._on_change()
        for action in actions:
            self._do(unit, node, action, reason)

    def _do(self, unit: str, node: _Managed, action: ManagedAction, reason: str) -> None:
        match action:
            case ManagedAction.ASK:
                node.to_do = asyncio.Queue()
                node.task = self._sources.begin(partial(self._converse, unit, node))
            case ManagedAction.LEAVE:
                if node.task is not None:
                    node.task.cancel()
                    node.task = None
            case ManagedAction.CONFIGURE | ManagedAction.ACTIVATE:
                node.to_do.put_nowait(action)
            case ManagedAction.REPORT_FAILED:
                goal = node.config.autostart
                _reported.error("%s does not %s: %s", node.config.name, goal, reason)
            case _:
                assert_never(action)

    async def _converse(self, unit: str, node: _Managed) -> None:
        """Drive one node instance to its goal state; cancelled when the node exits.

        An exception is a failure of this node, unless it is not managed any more.
        """
        task = node.task
        assert task is not None
        try:
            await self._talk(unit, node, task)
        except Exception as error:  # noqa: BLE001 - the others are not to pay for it
            _log.warning("%s cannot be talked to: %s", node.config.name, error)
            if not task.is_cancelled:
                self._apply(unit, ManagedInput.REFUSED, str(error))

    async def _talk(self, unit: str, node: _Managed, task: Source) -> None:
        """Ask for its state, and then for one transition after the other."""
        known: ManagedInput | None = None

        def hear(state: int) -> None:
            nonlocal known
            said = _INPUT_OF_STATE.get(state)
            if said is not None and not task.is_cancelled:
                known = said
                under_way = _UNDER_WAY.get(node.state)
                how = f"its transition {under_way} led to" if under_way else "it is in"
                self._apply(unit, said, f"{how} the state {said.removeprefix('is_')}")

        def see(state: int) -> None:
            # A transition that failed leads back to where it began, which is no news.
            if _INPUT_OF_STATE.get(state) is not known:
                hear(state)

        limit = node.config.timeout
        async with self._open_client(node.config.name, hear) as client:
            with anyio.move_on_after(limit) as asking:
                hear(await client.state())
            if asking.cancelled_caught and not task.is_cancelled:
                reason = (
                    "its lifecycle services did not answer"
                    if client.is_offered
                    else f"nobody offered the service {node.config.name}/get_state"
                )
                self._apply(unit, ManagedInput.OVERDUE, f"{reason} within {limit:g} s")
            while True:
                action = await _next_action(node, client, see)
                said, reason = await _change(client, action, limit)
                if task.is_cancelled:
                    return
                if said is _TRANSITIONS[action][1]:
                    known = said
                self._apply(unit, said, reason)


async def _next_action(
    node: _Managed, client: ManagedNode, on_state: Callable[[int], None]
) -> ManagedAction:
    """Give what is to be done next; look at a node that is left to itself a few times."""
    for pause in _LOOKS_AGAIN:
        with anyio.move_on_after(pause):
            return await node.to_do.get()
        with anyio.move_on_after(node.config.timeout):
            on_state(await client.state())
    return await node.to_do.get()


async def _change(
    client: ManagedNode, action: ManagedAction, limit: float
) -> tuple[ManagedInput, str]:
    """Ask for a transition and give it ``limit`` seconds; give what came of it, and why."""
    transition, leads_to = _TRANSITIONS[action]
    with anyio.move_on_after(limit):
        if await client.change(transition):
            return leads_to, ""
        return ManagedInput.REFUSED, f"its transition {action} failed"
    return ManagedInput.OVERDUE, f"its transition {action} took longer than {limit:g} s"
