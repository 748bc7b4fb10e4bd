"""A whole system: brought up, kept running, stopped."""

from __future__ import annotations

import asyncio
import logging
import math
from functools import partial
from typing import TYPE_CHECKING, Final

import anyio
from msgspec import Struct

from play_launch.actors.container.container import ContainerMember
from play_launch.actors.container.library_probes import LibraryProbes
from play_launch.actors.container.limits import LIMITS, Limits, default_starts
from play_launch.actors.container.nodes import AttemptNumbers
from play_launch.actors.launcher import NativeLauncher
from play_launch.actors.process_node import ProcessMember
from play_launch.config.model import ContainerType
from play_launch.core.exit_code import exit_code
from play_launch.core.member import MemberInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.member import Member
    from play_launch.actors.ports import Launcher
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.config.model import ContainerConfig, ReplayConfig
    from play_launch.core.node_key import NodeKey
    from play_launch.core.view import SystemView

_log = logging.getLogger(__name__)


class Outcome(Struct, frozen=True, kw_only=True):
    """How a run ended."""

    exit_code: int
    """As :mod:`play_launch.core.exit_code` says."""
    view: SystemView
    """The system at the moment in which the run began to end, so before it was stopped."""
    final_view: SystemView
    """The system after that."""
    reason: str
    signum: int | None = None


STOCK_STARTS: Final = 4
"""How many times as many stock containers start up at the same time: they spend most of it waiting
until they are found in the graph."""


def _slots_of(
    container: ContainerConfig, slots: asyncio.Semaphore, stock_slots: asyncio.Semaphore
) -> asyncio.Semaphore:
    if container.attach:
        # Waiting for somebody else's container takes no slot from those that start.
        return asyncio.Semaphore(1)
    return stock_slots if container.container_type is ContainerType.STOCK else slots


class System:
    """The members of a running system by their full names, and what can be asked of them.

    Belongs to the thread of the event loop.
    """

    def __init__(
        self,
        config: ReplayConfig,
        publisher: Publisher,
        stop: StopRequests,
        *,
        launcher: Launcher,
        limits: Limits = LIMITS,
        starts: int | None = None,
    ) -> None:
        """Know the members; ``starts`` is how many containers start up at the same time."""
        self._config = config
        self._publisher = publisher
        self._stop = stop
        attempts = AttemptNumbers()
        starts = starts or default_starts()
        slots = asyncio.Semaphore(starts)
        stock_slots = asyncio.Semaphore(STOCK_STARTS * starts)
        probes = LibraryProbes(launcher, publisher)
        self._containers = {
            container.full_name: ContainerMember(
                container,
                launcher=launcher,
                publisher=publisher,
                stop=stop,
                attempts=attempts,
                slots=_slots_of(container, slots, stock_slots),
                probes=None if container.container_type is ContainerType.STOCK else probes,
                limits=limits,
            )
            for container in config.containers
        }
        processes = {
            process.full_name: ProcessMember(
                process, launcher=launcher, publisher=publisher, stop=stop
            )
            for process in config.nodes
        }
        self._members: dict[str, Member] = {**self._containers, **processes}

    def start(self, member: str) -> None:
        """Have a container or executable run that does not; KeyError for an unknown name."""
        self._members[member].post(MemberInput.START)

    def stop(self, member: str, reason: str) -> None:
        """Have one stopped, for good; the others are left alone."""
        self._members[member].post(MemberInput.STOP, reason)

    def restart(self, member: str, reason: str) -> None:
        """Have one replaced by a new process, or started."""
        self._members[member].post(MemberInput.RESTART, reason)

    def load(self, node: NodeKey) -> None:
        """Have a composable node loaded; KeyError for an unknown one."""
        member = self._container_of(node)
        member.deliver(partial(member.nodes.load, node))

    def unload(self, node: NodeKey) -> None:
        """Have one unloaded, for good."""
        member = self._container_of(node)
        member.deliver(partial(member.nodes.unload, node))

    def reload(self, node: NodeKey) -> None:
        """Have one replaced by a new one, or loaded."""
        member = self._container_of(node)
        member.deliver(partial(member.nodes.reload, node))

    def _container_of(self, node: NodeKey) -> ContainerMember:
        """Find its container; KeyError here, for what is delivered fails the whole member."""
        member = self._containers[node.container]
        if node not in member.nodes:
            raise KeyError(node)
        return member

    async def run(self) -> Outcome:
        """Run it to its end, see `run_system`."""
        until = None
        if self._config.duration is not None:
            until = asyncio.get_running_loop().time() + self._config.duration
        for container in self._containers.values():
            container.announce()
        self._publisher.remember_view_before(self._stop)
        members = self._members.values()
        try:
            async with anyio.create_task_group() as tasks:
                for member in members:
                    member.begin(tasks)
                tasks.start_soon(self._end_with_members)
                if not await _happens_before(self._stop.requested, until):
                    reason = f"its duration of {self._config.duration:g} s is over"
                    self._stop.request(reason=reason)
                _log.info("stopping: %s", self._stop.reason)
                for member in members:
                    member.post(MemberInput.STOP, self._stop.reason)
                for member in members:
                    await member.rests()
                tasks.cancel_scope.cancel()
        finally:
            for member in members:
                member.close()
        view = self._publisher.view_before_stop
        return Outcome(
            exit_code=exit_code(view, self._stop.signum),
            view=view,
            final_view=self._publisher.view,
            reason=self._stop.reason,
            signum=self._stop.signum,
        )

    async def _end_with_members(self) -> None:
        """Ask for the end when nothing runs any more, nor is going to by itself."""
        members = self._members.values()
        while not all(member.is_at_rest for member in members):
            for member in members:
                await member.rests()
        self._stop.request(reason="nothing is left to run")


async def run_system(
    config: ReplayConfig,
    publisher: Publisher,
    stop: StopRequests,
    *,
    launcher: Launcher | None = None,
    limits: Limits = LIMITS,
    starts: int | None = None,
    on_begin: Callable[[System], None] = lambda _system: None,
) -> Outcome:
    """Run a system from its start to the end of its last process.

    It ends on a stop request, after the configured duration, or when nothing is left that could
    still run. When it returns, or is cancelled, no process of it is left.

    Args:
        config: What to run.
        publisher: Gets every event, on the loop's thread, and keeps the view.
        stop: The way to end it.
        launcher: Starts the processes; None for the real one.
        limits: Time limits for containers.
        starts: How many containers start up at the same time; None for `default_starts`.
        on_begin: Gets the system, to operate it while it runs.
    """
    if launcher is None:
        launcher = await asyncio.to_thread(NativeLauncher.of, config)
    try:
        # A participant that gets a port number of a dead one stumbles over what that one left.
        await launcher.clean_up()
        system = System(config, publisher, stop, launcher=launcher, limits=limits, starts=starts)
        on_begin(system)
        return await system.run()
    finally:
        await launcher.clean_up()
        await launcher.close()


async def _happens_before(event: asyncio.Event, when: float | None) -> bool:
    """Wait for an event; False when the loop's clock comes to ``when`` first (None: never)."""
    with anyio.CancelScope(deadline=math.inf if when is None else when):
        await event.wait()
    return event.is_set()
