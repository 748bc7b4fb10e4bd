"""A system under test, with everything that it published."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from play_launch.process.lines import Line
from play_launch.runtime.publisher import Publisher
from play_launch.runtime.run import RunOutcome, run_system
from play_launch.runtime.signals import StopRequests
from play_launch.runtime.system import System
from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Stream,
)
from play_launch.supervisor.view import SystemView

from .fake_parameters import FakeParameters

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from play_launch.config.model import ReplayConfig
    from play_launch.ros.access import RosAccess

    from .fakes import FakeLauncher


class Running:
    def __init__(self, launcher: FakeLauncher | None = None) -> None:
        self._launcher = launcher
        self.publisher = Publisher(self)
        self.stop = StopRequests()
        self.events: list[RunEvent] = []
        self.view = SystemView()
        self.outcome: RunOutcome | None = None
        self.task: asyncio.Task[RunOutcome] | None = None
        self.system: System | None = None
        self._published = asyncio.Event()

    @property
    def operated(self) -> System:
        assert self.system is not None
        return self.system

    def begins(self, system: System) -> None:
        self.system = system

    @property
    def launcher(self) -> FakeLauncher:
        assert self._launcher is not None
        return self._launcher

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        self.events.append(event)
        self.view = after
        self._published.set()

    def say(self, process: str, text: str) -> None:
        """Have a process write a line."""
        self.publisher.publish_output(process, 1, Stream.STDOUT, [Line(text)])

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(600):
            while not condition():
                self._published.clear()
                await self._published.wait()

    async def until_stopped(self) -> None:
        assert self.task is not None
        await asyncio.wait({self.task})

    async def until_loaded(self, count: int) -> None:
        await self.until(lambda: self.view.loaded == count)

    async def until_state(self, container: str, state: ContainerState) -> None:
        await self.until(
            lambda: (
                container in self.view.containers and self.view.containers[container].state is state
            )
        )

    def node_states(self, name: str) -> list[NodeState]:
        return [
            event.state
            for event in self.events
            if isinstance(event, NodeStateChanged) and event.node == name
        ]

    def node_events(self, name: str, state: NodeState) -> list[NodeStateChanged]:
        return [
            event
            for event in self.events
            if isinstance(event, NodeStateChanged) and (event.node, event.state) == (name, state)
        ]

    def container_states(self, name: str) -> list[ContainerState]:
        return [
            event.state
            for event in self.events
            if isinstance(event, ContainerStateChanged) and event.container == name
        ]

    def container_events(self, name: str, state: ContainerState) -> list[ContainerStateChanged]:
        return [
            event
            for event in self.events
            if isinstance(event, ContainerStateChanged)
            and (event.container, event.state) == (name, state)
        ]

    def gave_up(self) -> dict[str, str]:
        """Names of the containers and processes that were given up, with the reason."""
        return {
            event.name: event.message
            for event in self.events
            if isinstance(event, ProcessEvent) and event.kind is ProcessEventKind.GAVE_UP
        }

    def process_events(self, name: str) -> list[ProcessEventKind]:
        return [
            event.kind
            for event in self.events
            if isinstance(event, ProcessEvent) and event.name == name
        ]


@asynccontextmanager
async def running(
    config: ReplayConfig,
    launcher: FakeLauncher,
    *,
    parameters: FakeParameters | None = None,
    starts: int | None = None,
    ros: RosAccess | None = None,
) -> AsyncIterator[Running]:
    """Run a system inside the block; at its end it is stopped, and nothing may be left."""
    system = Running(launcher)
    system.task = task = asyncio.create_task(
        run_system(
            config,
            system.publisher,
            system.stop,
            launcher=launcher,
            parameters=parameters or FakeParameters(),
            starts=starts,
            ros=ros,
            on_begin=system.begins,
        )
    )
    try:
        yield system
        if not system.stop.requested.is_set():
            system.stop.request(reason="the test is over")
        system.outcome = await task
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert not launcher.alive(), "processes are left"
    assert launcher.cleaned
    assert launcher.closed
