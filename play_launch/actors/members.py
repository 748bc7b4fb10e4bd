"""The members of a running system: made from their configurations, added, replaced, taken out."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from play_launch.actors.container.attempts import AttemptNumbers
from play_launch.actors.container.container import ContainerMember
from play_launch.actors.container.library_probes import LibraryProbes
from play_launch.actors.container.limits import default_starts
from play_launch.actors.process_node import ProcessMember
from play_launch.config.model import ContainerConfig, ContainerType
from play_launch.core.events import SubjectKind
from play_launch.core.member import MemberInput

if TYPE_CHECKING:
    from anyio.abc import TaskGroup

    from play_launch.actors.container.limits import Limits
    from play_launch.actors.member import Member
    from play_launch.actors.ports import Launcher
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.start_conditions import StartConditions
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.config.model import ProcessConfig, ReplayConfig


class StuckError(Exception):
    """A process does not end, not even of SIGKILL."""


class Members:
    """Containers and ordinary executables by their full names; belongs to the event loop's thread.

    A name is a container's or an executable's, never both at the same time.
    """

    def __init__(
        self,
        config: ReplayConfig,
        publisher: Publisher,
        stop: StopRequests,
        *,
        launcher: Launcher,
        limits: Limits,
        starts: int | None,
        conditions: StartConditions,
    ) -> None:
        """Know the members; ``starts`` is how many containers start up at the same time."""
        self._conditions = conditions
        self._publisher = publisher
        self._stop = stop
        self._launcher = launcher
        self._limits = limits
        self._attempts = AttemptNumbers()
        self._slots = asyncio.Semaphore(starts or default_starts())
        self._probes = LibraryProbes(launcher, publisher)
        self._tasks: TaskGroup | None = None
        self.containers = {each.full_name: self._container(each) for each in config.containers}
        self.processes = {each.full_name: self._process(each) for each in config.nodes}

    @property
    def all(self) -> tuple[Member, ...]:
        """Those that there are now."""
        return (*self.containers.values(), *self.processes.values())

    @property
    def names(self) -> tuple[str, ...]:
        """Their full names."""
        return (*self.containers, *self.processes)

    def __getitem__(self, name: str) -> Member:
        """Find one; KeyError for an unknown name."""
        return self.containers[name] if name in self.containers else self.processes[name]

    def announce(self) -> None:
        """Publish what is declared."""
        for container in self.containers.values():
            container.announce()

    def begin(self, tasks: TaskGroup) -> None:
        """Have all of them run, in ``tasks``, and later those that are added."""
        self._tasks = tasks
        for member in self.all:
            member.begin(tasks)

    async def rest(self) -> None:
        """Wait until none of those that there are now runs."""
        for member in self.all:
            await member.rest.wait()

    def close(self) -> None:
        """Do nothing at any later time."""
        for member in self.all:
            member.close()

    def add(self, config: ContainerConfig | ProcessConfig) -> None:
        """Take in a new one and have it run."""
        assert self._tasks is not None
        if isinstance(config, ContainerConfig):
            container = self.containers[config.full_name] = self._container(config)
            container.announce()
            container.begin(self._tasks)
        else:
            process = self.processes[config.full_name] = self._process(config)
            process.begin(self._tasks)

    async def replace(self, config: ContainerConfig | ProcessConfig, reason: str) -> None:
        """Stop one, and have it run as it is configured now.

        Raises:
            StuckError: When its process does not end; nothing is started then.
        """
        member = self[config.full_name]
        await self._end(member, reason)
        if isinstance(config, ContainerConfig):
            # It is announced as a whole; what it has no more would stay in the view.
            shown = self._publisher.view.containers[config.full_name].nodes
            for key in sorted(shown.keys() - {node.key for node in config.composable_nodes}):
                self._publisher.withdraw(SubjectKind.NODE, str(key))
        self.add(config)

    async def remove(self, name: str, reason: str) -> None:
        """Stop one and forget it.

        Raises:
            StuckError: When its process does not end; it stays known then.
        """
        member = self[name]
        await self._end(member, reason)
        if self.containers.pop(name, None) is not None:
            self._publisher.withdraw(SubjectKind.CONTAINER, name)
        else:
            del self.processes[name]
            self._publisher.withdraw(SubjectKind.PROCESS, name)

    async def _end(self, member: Member, reason: str) -> None:
        while True:
            member.post(MemberInput.STOP, reason)
            # Whoever has it started meanwhile gets what comes in its place.
            if await member.rest.wait_unless_recalled():
                break
        if member.is_stuck:
            raise StuckError("its process does not die, not even of SIGKILL")
        member.close()

    def _container(self, config: ContainerConfig) -> ContainerMember:
        is_ours = config.container_type is not ContainerType.STOCK
        member = ContainerMember(
            config,
            launcher=self._launcher,
            publisher=self._publisher,
            stop=self._stop,
            attempts=self._attempts,
            # Waiting for somebody else's container takes no slot from those that start.
            turn=self._conditions.turn(config.full_name, None if config.attach else self._slots),
            order=self._conditions.order,
            probes=self._probes if is_ours else None,
            limits=self._limits,
        )
        member.when_settled(self._conditions.order.look_again)
        return member

    def _process(self, config: ProcessConfig) -> ProcessMember:
        member = ProcessMember(
            config,
            launcher=self._launcher,
            publisher=self._publisher,
            stop=self._stop,
            turn=self._conditions.turn(config.full_name),
        )
        member.when_settled(self._conditions.order.look_again)
        return member
