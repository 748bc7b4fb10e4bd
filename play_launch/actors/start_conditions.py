"""What the members of a system wait for: who is asked, who decides, and the way back at its end."""

from __future__ import annotations

import logging
from functools import partial
from typing import TYPE_CHECKING

import anyio

from play_launch.actors.first_of import first_of
from play_launch.actors.managed_nodes import ManagedNodes
from play_launch.actors.order import StartOrder
from play_launch.actors.sources import Sources
from play_launch.actors.turn import StartTurn
from play_launch.actors.units import Units
from play_launch.actors.world import World
from play_launch.core.dependency import DependencyGraph
from play_launch.core.member import MemberInput

if TYPE_CHECKING:
    import asyncio

    from anyio.abc import TaskGroup

    from play_launch.actors.member import Member
    from play_launch.actors.members import Members
    from play_launch.actors.ports import RosAccess
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.config.model import ReplayConfig
    from play_launch.core.dependency import Dependency
    from play_launch.core.order import Look

_log = logging.getLogger(__name__)


class StartConditions:
    """Belongs to the thread of the event loop."""

    def __init__(
        self,
        config: ReplayConfig,
        publisher: Publisher,
        ros: RosAccess | None = None,
    ) -> None:
        """Take the rules of the configuration; `attach` gives the members.

        ``ros`` is asked about the graph and managed nodes, if need be; None is the real one.
        """
        self._publisher = publisher
        self._sources = Sources(
            lambda error: _log.error("files are not waited for any more: %s", error, exc_info=error)
        )
        self._environment = config.environment
        self._ros_access = ros
        self._units: Units | None = None
        self._world = World(self._look_again, lambda found: self._ros().watch_graph(found))
        self._managed = ManagedNodes(
            publisher, self._look_again, lambda name, hear: self._ros().managed_node(name, hear)
        )
        self.order = StartOrder(look=self.look, watch=self._world.watch, report=self._report_wait)
        self.use(config)
        publisher.add_sink(self._world)
        publisher.add_sink(self._managed)

    def use(self, config: ReplayConfig) -> None:
        """Have other rules hold from now on; who runs already is not touched by them."""
        self._rules = rules = config.start_rules
        self._managed.use(config.managed)
        self._world.expect(rules.values())
        self.order.use(rules)

    def begin(self, tasks: TaskGroup) -> None:
        """Do what has to be done meanwhile, in ``tasks``."""
        self._sources.run_in(tasks)
        self._sources.begin(self._world.run)
        self._managed.run_in(tasks)

    def turn(self, unit: str, slots: asyncio.Semaphore | None = None) -> StartTurn:
        """Make the turn of a member, with what bounds how many start at a time."""
        return StartTurn(slots, partial(self.order.turn, unit))

    def attach(self, members: Members) -> None:
        """Take the members; they may come and go."""
        self._units = Units(members, self._publisher, self._world.holds, self._managed.look)

    async def stop_in_reverse(self, members: Members, stop: StopRequests) -> None:
        """Stop all members, each after those that depend on it; at once when that is hurried."""
        self.order.close()
        units = dict.fromkeys(members.processes, ()) | {
            name: tuple(map(str, container.nodes)) for name, container in members.containers.items()
        }
        before = DependencyGraph(self._rules, units).stopped_after()
        async with anyio.create_task_group() as tasks:
            for name in members.names:
                if before[name]:
                    others = [members[other] for other in before[name]]
                    tasks.start_soon(_stop_after, others, members[name], stop)
                else:
                    members[name].post(MemberInput.STOP, stop.reason)
        await members.rest()

    async def close(self) -> None:
        """Let nobody through any more, and look at nothing."""
        self.order.close()
        await self._world.close()

    def look(self, dependency: Dependency) -> Look:
        """Say how a condition stands."""
        assert self._units is not None
        return self._units.look(dependency)

    # Its parts need each other.

    def _report_wait(self, unit: str, text: str) -> None:
        assert self._units is not None
        self._units.report_wait(unit, text)

    def _look_again(self) -> None:
        self.order.look_again()

    def _ros(self) -> RosAccess:
        if self._ros_access is None:
            # Only for those who ask.
            from play_launch.ros.access import RosAccess  # noqa: PLC0415

            self._ros_access = RosAccess(self._environment)
        return self._ros_access


async def _stop_after(others: list[Member], member: Member, stop: StopRequests) -> None:
    for other in others:
        await first_of(other.rest.wait(), stop.hurry.wait())
    member.post(MemberInput.STOP, stop.reason)
