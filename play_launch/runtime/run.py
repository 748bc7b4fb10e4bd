"""A run of a system, from its start to the end of its last process."""

from __future__ import annotations

import asyncio
import os
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.runtime.launcher import NativeLauncher
from play_launch.runtime.system import System
from play_launch.supervisor.inputs import Origin, Over
from play_launch.supervisor.view import exit_code

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ReplayConfig
    from play_launch.recording.decisions import DecisionLog
    from play_launch.ros.access import RosAccess
    from play_launch.ros.parameters import ParameterSetter
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.signals import StopRequests
    from play_launch.supervisor.view import SystemView
    from play_launch.supervisor.world import Limits

_STARTS: Final = max(16, 4 * (os.cpu_count() or 1))
"""Containers that start at the same time: enough for all of most systems, see
docs/decisions/start.md. Hundreds would outlast the limits that each has for its start."""


class RunOutcome(Struct, frozen=True, kw_only=True):
    """How a run ended."""

    exit_code: int
    """As `play_launch.supervisor.view.exit_code` has it."""
    view: SystemView
    """The system when the run began to end, so before it was stopped."""
    final_view: SystemView
    """The system after that."""


async def run_system(
    config: ReplayConfig,
    publisher: Publisher,
    stop: StopRequests,
    *,
    launcher: NativeLauncher | None = None,
    parameters: ParameterSetter | None = None,
    limits: Limits | None = None,
    starts: int | None = None,
    ros: RosAccess | None = None,
    on_begin: Callable[[System], None] = lambda _system: None,
    decisions: DecisionLog | None = None,
) -> RunOutcome:
    """Run a system from its start to the end of its last process.

    It ends on a stop request, after the configured duration, or when nothing is left that could
    still run. When it returns, or is cancelled, no process of it is left.

    Args:
        config: What to run.
        publisher: Gets every event, on the loop's thread, and keeps the view.
        stop: The way to end it.
        launcher: Starts the processes; None for the real one.
        parameters: Sets parameters of nodes; None for the real one.
        limits: Time limits.
        starts: How many containers start at the same time; None for the default.
        ros: Access to the graph and to managed nodes; None for the real one.
        on_begin: Gets the system, to operate it while it runs.
        decisions: Gets what is decided upon.
    """
    if launcher is None:
        launcher = await asyncio.to_thread(NativeLauncher, config, publisher.publish)
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
            starts=starts or _STARTS,
            ros=ros,
            decisions=decisions,
        )
        on_begin(system)
        time = asyncio.get_running_loop().time
        if decisions is not None:
            world = system.world
            origin = Origin(config, world.starts, world.limits, publisher.stamp_ns())
            decisions.add(time(), origin)
        try:
            await system.run()
        finally:
            if decisions is not None:
                decisions.add(time(), Over())
        view = system.view_before_stop
        return RunOutcome(
            exit_code=exit_code(view, publisher.view, stop.signum),
            view=view,
            final_view=publisher.view,
        )
    finally:
        await launcher.clean_up()
        await launcher.close()
