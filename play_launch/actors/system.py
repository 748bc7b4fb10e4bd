"""A whole system: brought up, kept running, stopped."""

from __future__ import annotations

import asyncio
import logging
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch.actors.container.container import ContainerActor
from play_launch.actors.container.library_probes import LibraryProbes
from play_launch.actors.container.limits import LIMITS, Limits
from play_launch.actors.container.nodes import AttemptNumbers
from play_launch.actors.deadline import happens_before
from play_launch.actors.launcher import NativeLauncher
from play_launch.actors.process_node import ProcessActor
from play_launch.actors.publisher import Publisher
from play_launch.config.model import ContainerType
from play_launch.core.exit_code import exit_code

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.actors.ports import Launcher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.config.model import ContainerConfig, ReplayConfig
    from play_launch.core.events import EventSink
    from play_launch.core.view import SystemView

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """How a run ended."""

    exit_code: int
    """As :mod:`play_launch.core.exit_code` says."""
    view: SystemView
    """The system at the moment in which the run began to end, so before it was stopped."""
    final_view: SystemView
    """The system after that."""
    reason: str
    signum: int | None = None


def default_starts() -> int:
    """How many containers start up at the same time: creating a participant is CPU time."""
    return max(4, 2 * (os.cpu_count() or 1))


STOCK_STARTS: Final = 4
"""How many times as many stock containers start up at the same time: they spend most of it waiting
until they are found in the graph."""


def _starts_of(
    container: ContainerConfig, places: asyncio.Semaphore, stock_places: asyncio.Semaphore
) -> asyncio.Semaphore:
    if container.attach:
        # Waiting for somebody else's container takes no place from those that start.
        return asyncio.Semaphore(1)
    return stock_places if container.container_type is ContainerType.STOCK else places


async def run_system(
    config: ReplayConfig,
    sink: EventSink,
    stop: StopRequests,
    *,
    launcher: Launcher | None = None,
    limits: Limits = LIMITS,
    starts: int | None = None,
) -> Outcome:
    """Run a system from its start to the end of its last process.

    It ends on a stop request, after the configured duration, or when nothing is left that could
    still run. When it returns, or is cancelled, no process of it is left.

    Args:
        config: What to run.
        sink: Gets every event, on the loop's thread.
        stop: The way to end it.
        launcher: Starts the processes; None for the real one.
        limits: Time limits for containers.
        starts: How many containers start up at the same time; None for `default_starts`.
    """
    if launcher is None:
        launcher = await asyncio.to_thread(NativeLauncher.of, config)
    try:
        # A participant that gets a port number of a dead one stumbles over what that one left.
        await launcher.clean_up()
        return await _run(
            config, Publisher(sink), stop, launcher=launcher, limits=limits, starts=starts
        )
    finally:
        await launcher.clean_up()
        await launcher.close()


async def _run(
    config: ReplayConfig,
    publisher: Publisher,
    stop: StopRequests,
    *,
    launcher: Launcher,
    limits: Limits,
    starts: int | None,
) -> Outcome:
    loop = asyncio.get_running_loop()
    until = None if config.duration is None else loop.time() + config.duration
    attempts = AttemptNumbers()
    starts = starts or default_starts()
    places = asyncio.Semaphore(starts)
    probes = LibraryProbes(launcher, publisher)
    stock_places = asyncio.Semaphore(STOCK_STARTS * starts)
    containers = [
        ContainerActor(
            container,
            launcher=launcher,
            publisher=publisher,
            stop=stop,
            attempts=attempts,
            starts=_starts_of(container, places, stock_places),
            probes=None if container.container_type is ContainerType.STOCK else probes,
            limits=limits,
        )
        for container in config.containers
    ]
    processes = [
        ProcessActor(process, launcher=launcher, publisher=publisher, stop=stop)
        for process in config.nodes
    ]
    for container in containers:
        container.announce()
    publisher.remember_view_before(stop)
    actors: list[ContainerActor | ProcessActor] = [*containers, *processes]
    async with asyncio.TaskGroup() as tasks:
        running = [tasks.create_task(actor.run()) for actor in actors]
        tasks.create_task(_end_with(running, stop))
        if not await happens_before(stop.requested, until):
            stop.request(reason=f"its duration of {config.duration:g} s is over")
        _log.info("stopping: %s", stop.reason)
    view = publisher.view_before_stop
    return Outcome(
        exit_code=exit_code(view, stop.signum),
        view=view,
        final_view=publisher.view,
        reason=stop.reason,
        signum=stop.signum,
    )


async def _end_with(running: Iterable[asyncio.Task[None]], stop: StopRequests) -> None:
    """Ask for the end when every actor has ended by itself."""
    for task in running:
        await asyncio.wait({task})
    if not stop.requested.is_set():
        stop.request(reason="nothing is left to run")
