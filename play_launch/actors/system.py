"""A whole system: brought up, kept running, stopped."""

from __future__ import annotations

import asyncio
import logging
import math
from functools import partial
from typing import TYPE_CHECKING

import anyio
from msgspec import Struct

from play_launch.actors.arrivals import Arrivals
from play_launch.actors.container.limits import LIMITS, Limits
from play_launch.actors.launcher import NativeLauncher
from play_launch.actors.members import Members
from play_launch.actors.start_conditions import StartConditions
from play_launch.core.exit_code import exit_code
from play_launch.core.member import MemberInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.applying import Applying
    from play_launch.actors.container.container import ContainerMember
    from play_launch.actors.ports import Launcher, ParameterService, RosAccess
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.config.model import ReplayConfig
    from play_launch.core.events import ContainerState
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
        parameters: ParameterService | None = None,
        limits: Limits = LIMITS,
        starts: int | None = None,
        ros: RosAccess | None = None,
    ) -> None:
        """Know the members; ``starts`` is how many containers start up at the same time.

        ``ros`` is asked about the graph and managed nodes, if need be; None is the real one.
        """
        self._config = config
        self._publisher = publisher
        self._stop = stop
        self._conditions = StartConditions(config, publisher, ros)
        self._members = Members(
            config,
            publisher,
            stop,
            launcher=launcher,
            limits=limits,
            starts=starts,
            conditions=self._conditions,
        )
        self._conditions.attach(self._members)
        self._arrivals = Arrivals(self._members, publisher, self._conditions.look)
        self._coming_at_end: tuple[str, ...] | None = None
        self._has_begun = False
        self._launcher = launcher
        self._parameters = parameters
        self._applying: Applying | None = None
        self._recalled = asyncio.Event()

    @property
    def processes(self) -> tuple[str, ...]:
        """Full names of the ordinary executables, as declared."""
        return tuple(self._members.processes)

    @property
    def config(self) -> ReplayConfig:
        """As it is configured now."""
        return self._config if self._applying is None else self._applying.config

    @property
    def applying(self) -> Applying:
        """What changes it while it runs."""
        if self._applying is None:
            # The start of a system needs none of it.
            from play_launch.actors.applying import Applying  # noqa: PLC0415
            from play_launch.ros.parameter_setter import ParameterSetter  # noqa: PLC0415

            self._applying = Applying(
                self._config,
                self._members,
                self._publisher,
                self._stop,
                launcher=self._launcher,
                parameters=self._parameters or ParameterSetter(),
                # A system of which nothing runs may be brought up again.
                on_begin=self._recalled.set,
                use_rules=self._conditions.use,
            )
        return self._applying

    async def until_applied(self) -> None:
        """Wait until no configuration is being applied."""
        if self._applying is not None:
            await self._applying.idle.wait()

    @property
    def is_stopping(self) -> bool:
        """Whether its end was asked for."""
        return self._stop.requested.is_set()

    @property
    def is_changing(self) -> bool:
        """Whether another configuration is being applied."""
        return self._applying is not None and not self._applying.idle.is_set()

    @property
    def coming(self) -> tuple[str, ...]:
        """Units that have neither been up nor failed for good, as it was when its end began."""
        if self._coming_at_end is not None:
            return self._coming_at_end
        if not self._has_begun:
            return tuple(self._members.names)
        return self._arrivals.coming(self.config.managed.get)

    def ailment(self) -> str:
        """Say which member is not looked after any more, and why; empty: all are."""
        ailments = ((member.name, member.ailment()) for member in self._members.all)
        return next((f"{name}: {ailment}" for name, ailment in ailments if ailment), "")

    def state_of(self, member: str) -> ContainerState:
        """State of a container or executable; KeyError for an unknown name."""
        return self._members[member].state

    async def end_of(self, member: str) -> ContainerState | None:
        """Wait until one is at rest and return its state; None when it is wanted again before."""
        found = self._members[member]
        return found.state if await found.rest.wait_unless_recalled() else None

    def start(self, member: str) -> None:
        """Have a container or executable run that does not; KeyError for an unknown name.

        It does not wait for what it depends on.
        """
        self._recalled.set()
        self._conditions.order.release(member)
        self._members[member].post(MemberInput.START)

    def stop(self, member: str, reason: str) -> None:
        """Have one stopped, for good; the others are left alone."""
        self._members[member].post(MemberInput.STOP, reason)

    def restart(self, member: str, reason: str) -> None:
        """Have one replaced by a new process, or started."""
        self._recalled.set()
        self._conditions.order.release(member)
        self._members[member].post(MemberInput.RESTART, reason)

    def load(self, node: NodeKey) -> None:
        """Have a composable node loaded, whatever it waits for; KeyError for an unknown one."""
        member = self._container_of(node)
        self._conditions.order.release(str(node))
        member.deliver(partial(member.nodes.load, node))

    def unload(self, node: NodeKey) -> None:
        """Have one unloaded, for good."""
        member = self._container_of(node)
        self._conditions.order.forget(str(node))
        member.deliver(partial(member.nodes.unload, node))

    def reload(self, node: NodeKey) -> None:
        """Have one replaced by a new one, or loaded."""
        member = self._container_of(node)
        self._conditions.order.release(str(node))
        member.deliver(partial(member.nodes.reload, node))

    def _container_of(self, node: NodeKey) -> ContainerMember:
        """Find its container; KeyError here, for what is delivered fails the whole member."""
        member = self._members.containers[node.container]
        if node not in member.nodes:
            raise KeyError(node)
        return member

    async def run(self) -> Outcome:
        """Run it to its end, see `run_system`."""
        until = None
        if self._config.duration is not None:
            until = asyncio.get_running_loop().time() + self._config.duration
        self._members.announce()
        self._publisher.remember_view_before(self._stop)
        try:
            async with anyio.create_task_group() as tasks:
                self._conditions.begin(tasks)
                self._members.begin(tasks)
                self._has_begun = True
                tasks.start_soon(self._end_with_members)
                if not await _happens_before(self._stop.requested, until):
                    reason = f"its duration of {self._config.duration:g} s is over"
                    self._stop.request(reason=reason)
                self._coming_at_end = self.coming
                _log.info("stopping: %s", self._stop.reason)
                # None is added any more, or it would not start.
                await self._conditions.stop_in_reverse(self._members, self._stop)
                tasks.cancel_scope.cancel()
        finally:
            self._members.close()
            await self._conditions.close()
            if self._applying is not None:
                await self._applying.close()
        view = self._publisher.view_before_stop
        return Outcome(
            exit_code=exit_code(view, self._publisher.view, self._stop.signum),
            view=view,
            final_view=self._publisher.view,
            reason=self._stop.reason,
            signum=self._stop.signum,
        )

    async def _end_with_members(self) -> None:
        """Ask for the end when nothing runs any more, nor is going to by itself.

        Whoever was stopped by a person is there to be started again: that is no end.
        """
        while True:
            await self._members.rest()
            if self._applying is not None:
                await self._applying.idle.wait()
            if not all(member.is_at_rest for member in self._members.all):
                continue
            if self._publisher.view.dismissed.isdisjoint(self._members.names):
                break
            self._recalled.clear()
            await self._recalled.wait()
        self._stop.request(reason="nothing is left to run")


async def run_system(
    config: ReplayConfig,
    publisher: Publisher,
    stop: StopRequests,
    *,
    launcher: Launcher | None = None,
    parameters: ParameterService | None = None,
    limits: Limits = LIMITS,
    starts: int | None = None,
    ros: RosAccess | None = None,
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
        parameters: Sets parameters of nodes; None for the real one.
        limits: Time limits for containers.
        starts: How many containers start up at the same time; None for `default_starts`.
        ros: Is asked about the graph and managed nodes, if need be; None for the real one.
        on_begin: Gets the system, to operate it while it runs.
    """
    if launcher is None:
        launcher = await asyncio.to_thread(NativeLauncher.of, config, publisher.publish)
    try:
        # A participant that gets a port number of a dead one stumbles over what that one left.
        await launcher.clean_up()
        system = System(
            config,
            publisher,
            stop,
            launcher=launcher,
            parameters=parameters,
            limits=limits,
            starts=starts,
            ros=ros,
        )
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
