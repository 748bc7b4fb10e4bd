"""What starts depend on besides processes: lines, files, the graph; and managed nodes."""

from __future__ import annotations

import asyncio
import logging
import os.path
import re
from functools import partial
from typing import TYPE_CHECKING, Final

import anyio

from play_launch.config.dependency import ABOUT_GRAPH, Condition
from play_launch.process.descendants import in_a_thread
from play_launch.supervisor.events import ExpectationChanged, ManagedState, OutputLine
from play_launch.supervisor.inputs import Found, GoalReported, ManagedInput

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.dependency import Dependency, StartRule
    from play_launch.ros.access import GraphSource
    from play_launch.ros.managed_node import ManagedNodeClient
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.view import SystemView

_log = logging.getLogger(__name__)

_FILE_POLL: Final = 0.1
"""Seconds between two checks of files that are waited for."""
_INPUT_OF_STATE: Final = {
    1: ManagedInput.IS_UNCONFIGURED,
    2: ManagedInput.IS_INACTIVE,
    3: ManagedInput.IS_ACTIVE,
    4: ManagedInput.IS_FINALIZED,
}
"""By the numbers of ``lifecycle_msgs/msg/State``; the others are on the way between these."""
_TRANSITIONS: Final = {
    ManagedState.CONFIGURING: ("configure", 1, ManagedInput.IS_INACTIVE),
    ManagedState.ACTIVATING: ("activate", 3, ManagedInput.IS_ACTIVE),
}
"""Names and numbers of ``lifecycle_msgs/msg/Transition``, and where they lead."""
_CHECKS: Final = (1.0, 2.0, 4.0, 8.0)
"""Seconds between checks of an idle node. A state that it entered before DDS had
connected its topic with us is never reported; that takes up to 3.3 s after its services exist,
more on a busy machine."""


class Outside:
    """Posts conditions that are met, as long as a unit waits for them; a sink for the events.

    A line counts from when it was written; files and the graph count as they are now.
    """

    def __init__(self, system: System) -> None:
        self._system = system
        self._graph: GraphSource | None = None
        self._files: frozenset[str] = frozenset()
        self._watched: frozenset[tuple[Condition, str]] = frozenset()
        self._met: frozenset[tuple[Condition, str, str]] = frozenset()
        self._told: frozenset[tuple[Condition, str, str]] = frozenset()
        """Those of other machines."""
        self._patterns: dict[str, dict[str, re.Pattern[str]]] = {}
        self._looked_for: set[str] = set()
        """Files with a task that looks for them; it is held up where a mount does not answer."""

    def expect(self, rules: Iterable[StartRule]) -> None:
        """Search output for the patterns of these rules, from now on."""
        self._patterns.clear()
        for rule in rules:
            for each in rule.dependencies:
                is_met = (each.condition, each.unit, each.subject) in self._met
                if each.condition is Condition.LOG and not is_met:
                    patterns = self._patterns.setdefault(each.unit, {})
                    patterns[each.subject] = re.compile(each.subject)

    def watch(self, pending: Iterable[Dependency]) -> None:
        """Watch the conditions of these dependencies only; others are forgotten."""
        wanted = [(each.condition, each.subject) for each in pending]
        files = frozenset(path for condition, path in wanted if condition is Condition.FILE)
        if files != self._files:
            self._files = files
            self._post(
                frozenset(
                    (condition, unit, subject)
                    for condition, unit, subject in self._met
                    if condition is not Condition.FILE or subject in files
                )
            )
            for path in files - self._looked_for:
                self._looked_for.add(path)
                self._system.tasks.begin(partial(self._look_for, path))
        watched = frozenset(each for each in wanted if each[0] in ABOUT_GRAPH)
        if watched != self._watched:
            self._watched = watched
            self._see_graph(frozenset((kind, name) for kind, _, name in self._met))
            if self._graph is None:
                self._graph = self._system.ros.watch_graph(self._see_graph)
            self._graph.watch(watched)

    def tell(self, met: frozenset[tuple[Condition, str, str]]) -> None:
        """Replace the conditions that are met on other machines."""
        before, self._told = self._told, met
        self._post((self._met - before) | met)

    async def _look_for(self, path: str) -> None:
        """Look for a file as long as it is waited for; EACCES, EIO and the like count as no."""
        try:
            while path in self._files:
                is_there = await in_a_thread(partial(os.path.exists, path))
                about, met = (Condition.FILE, "", path), self._met
                if path in self._files:
                    self._post(met | {about} if is_there else met - {about})
                await anyio.sleep(_FILE_POLL)
        finally:
            self._looked_for.discard(path)

    def _see_graph(self, found: frozenset[tuple[Condition, str]]) -> None:
        others = frozenset(each for each in self._met if each[0] not in ABOUT_GRAPH)
        self._post(others | {(kind, "", subject) for kind, subject in found & self._watched})

    def _post(self, met: frozenset[tuple[Condition, str, str]]) -> None:
        if met != self._met:
            self._met = met
            self._system.post(Found(met))

    async def close(self) -> None:
        """Cancel all watches."""
        if self._graph is not None:
            await self._graph.close()

    def publish(self, event: RunEvent, _before: SystemView, _after: SystemView) -> None:
        """Search a line of output for the patterns; note whether topics are as expected."""
        if isinstance(event, ExpectationChanged):
            about = frozenset({(Condition.EXPECT, "", event.topic)})
            self._post(self._met | about if event.is_met else self._met - about)
        if not isinstance(event, OutputLine) or event.process not in self._patterns:
            return
        patterns = self._patterns[event.process]
        for text in [text for text, pattern in patterns.items() if pattern.search(event.text)]:
            del patterns[text]
            self._post(self._met | {(Condition.LOG, event.process, text)})


class Conversation:
    """With one instance of a managed (lifecycle) node: states are inputs, transitions effects."""

    def __init__(self, system: System, unit: str, instance: int) -> None:
        self.instance = instance
        self._system = system
        self._unit = unit
        self._goal = system.world.goals[unit]
        self._to_do: asyncio.Queue[ManagedState] = asyncio.Queue()
        self._known: ManagedInput | None = None
        self._scope = system.tasks.begin(self._converse, unit)

    def transit(self, to: ManagedState) -> None:
        """Request a transition."""
        self._to_do.put_nowait(to)

    def end(self) -> None:
        """Cancel all requests: the node exited, or is not managed any more."""
        self._scope.cancel()

    def _report(self, said: ManagedInput, reason: str = "") -> None:
        if not self._scope.cancel_called:
            self._system.post(GoalReported(self._unit, self.instance, said, reason))

    async def _converse(self) -> None:
        """Drive the node; an exception is a failure of this node."""
        name = self._goal.config.name
        try:
            async with self._system.ros.managed_node(name, self._accept) as client:
                await self._talk(client)
        except Exception as error:  # noqa: BLE001 - the others go on
            _log.warning("%s cannot be talked to: %s", name, error)
            self._report(ManagedInput.REFUSED, str(error))

    def _accept(self, number: int) -> None:
        said = _INPUT_OF_STATE.get(number)
        if said is not None:
            self._known = said
            state = self._system.world.goals.get(self._unit, self._goal).state
            under_way = _TRANSITIONS.get(state)
            how = f"its transition {under_way[0]} led to" if under_way else "it is in"
            self._report(said, f"{how} the state {said.removeprefix('is_')}")

    async def _talk(self, client: ManagedNodeClient) -> None:
        """Request its state, and then one transition after the other."""
        name, limit = self._goal.config.name, self._goal.config.timeout
        with anyio.move_on_after(limit) as asking:
            self._accept(await client.state())
        if asking.cancelled_caught:
            reason = (
                "its lifecycle services did not answer"
                if client.is_offered
                else f"the service {name}/get_state was not available"
            )
            self._report(ManagedInput.OVERDUE, f"{reason} within {limit:g} s")
        while True:
            transition, number, leads_to = _TRANSITIONS[await self._next_transition(client)]
            said = ManagedInput.OVERDUE
            reason = f"its transition {transition} took longer than {limit:g} s"
            with anyio.move_on_after(limit):
                if await client.change(number):
                    said, reason = leads_to, ""
                    self._known = said
                else:
                    said, reason = ManagedInput.REFUSED, f"its transition {transition} failed"
            self._report(said, reason)

    async def _next_transition(self, client: ManagedNodeClient) -> ManagedState:
        """Give the next transition; check the state of an idle node a few times."""
        for pause in _CHECKS:
            with anyio.move_on_after(pause):
                return await self._to_do.get()
            with anyio.move_on_after(self._goal.config.timeout):
                state = await client.state()
                # A transition that failed leads back to where it began, which is no news.
                if _INPUT_OF_STATE.get(state) is not self._known:
                    self._accept(state)
        return await self._to_do.get()
