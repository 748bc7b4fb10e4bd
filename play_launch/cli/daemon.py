"""``play-launch daemon``: the daemon that answers ros2cli's questions about the graph."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated, Any

import typer

from play_launch.cli.daemon_patch import patch, unpatch
from play_launch.cli.failure import fail
from play_launch.cli.show.terminal import say, wants_colour
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.graph_daemon.contract import DaemonAddress
    from play_launch.graph_daemon.control.takeover import Occupant

daemon_app = typer.Typer(
    name="daemon",
    help="The daemon that answers ros2's questions about the graph, built to bear a start-up "
    "storm. It serves at the address of ros2cli's own daemon, so 'ros2 node list' and the like "
    "use it as it is.",
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
)

_IdleTimeout = Annotated[
    str,
    typer.Option(
        help="End after this time without a request: 2h, 30min; 0s for never.", metavar="TIME"
    ),
]
_Json = Annotated[bool, typer.Option("--json", help="One JSON object, for machines.")]
_NOT_RUNNING = ExitCode.NODE_FAILED


def start(
    restart: Annotated[
        bool, typer.Option("--restart", help="Replace one that runs, for new settings.")
    ] = False,
    idle_timeout: _IdleTimeout = "2h",
) -> None:
    """Start the daemon of this ROS_DOMAIN_ID, and wait until it knows the graph.

    If ros2cli's own daemon runs, it is replaced. If ours runs already, it is kept, with a warning
    where its settings are not yours.
    """
    address, seconds = _address(), _seconds(idle_timeout)
    _require_ros()
    from play_launch.graph_daemon.control.start_stop import (  # noqa: PLC0415
        PortHeldError,
        StartError,
        start_daemon,
    )

    try:
        started = start_daemon(address, idle_timeout=seconds, restart=restart)
    except (PortHeldError, StartError, OSError) as error:
        fail(f"{error}", ExitCode.NODE_FAILED)
    started.let_go()
    if started.started:
        say(f"the daemon of domain {address.domain} was started (pid {started.pid})")
        for message in started.messages:
            say(message)
        return
    say(f"the daemon of domain {address.domain} is running already (pid {started.pid})")
    for message in started.messages:
        warn(message)
    if started.messages:
        warn("'play-launch daemon start --restart' takes your settings")


def stop() -> None:
    """Stop the daemon of this ROS_DOMAIN_ID, ours or ros2cli's; the port is free afterwards."""
    address = _address()
    from play_launch.graph_daemon.control.start_stop import PortHeldError, stop_daemon  # noqa: PLC0415
    from play_launch.graph_daemon.control.takeover import Kind  # noqa: PLC0415

    try:
        occupant = stop_daemon(address)
    except (PortHeldError, OSError) as error:
        fail(f"{error}", ExitCode.NODE_FAILED)
    if occupant.kind is Kind.NOBODY:
        say(f"no daemon runs for domain {address.domain}")
    else:
        whose = "ros2cli's daemon" if occupant.kind is Kind.STOCK else "the daemon"
        say(f"{whose} of domain {address.domain} was stopped")


def status(as_json: _Json = False) -> None:
    """Report whether a daemon runs for this ROS_DOMAIN_ID, whose, and how it is.

    Warns where its settings are not those of your environment: then it sees another graph than
    your programs. Exits with 1 when none runs.
    """
    import json  # noqa: PLC0415

    from play_launch.graph_daemon.control.takeover import Kind, look, settings_warnings  # noqa: PLC0415
    from play_launch.graph_daemon.settings import compared_settings  # noqa: PLC0415

    address = _address()
    occupant = look(address)
    warnings = [*settings_warnings(occupant, compared_settings(os.environ)), *_blind(occupant)]
    if as_json:
        kinds = {Kind.OURS: "play_launch", Kind.STOCK: "ros2cli", Kind.NOBODY: None}
        values = {
            "running": occupant.kind in {Kind.OURS, Kind.STOCK},
            "daemon": kinds.get(occupant.kind, occupant.kind.name.lower()),
            "domain": address.domain,
            "url": address.url,
            "pid": occupant.holder.pid if occupant.holder else 0,
            "problem": occupant.problem,
            "warnings": warnings,
            **occupant.status,
        }
        say(json.dumps(values, ensure_ascii=False))
    else:
        for line in describe(address, occupant):
            say(line)
        for warning in warnings:
            warn(warning)
    if occupant.kind not in {Kind.OURS, Kind.STOCK}:
        raise typer.Exit(_NOT_RUNNING)


def run(idle_timeout: _IdleTimeout = "0s") -> None:
    """Run the daemon here, in the foreground, until Ctrl-C; for services and containers."""
    address, seconds = _address(), _seconds(idle_timeout)
    _require_ros()
    import asyncio  # noqa: PLC0415
    import logging  # noqa: PLC0415

    from play_launch.graph_daemon.contract import WARM  # noqa: PLC0415
    from play_launch.graph_daemon.control.start_stop import PortHeldError, acquire  # noqa: PLC0415
    from play_launch.graph_daemon.server.daemon import Daemon  # noqa: PLC0415

    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    try:
        port = acquire(address)
    except (PortHeldError, OSError) as error:
        fail(f"{error}", ExitCode.NODE_FAILED)
    if port.listener is None:
        fail(
            f"the daemon of domain {address.domain} is running already (pid {port.pid})",
            ExitCode.NODE_FAILED,
        )
    for message in port.messages:
        say(message)
    daemon = Daemon(address, idle_timeout=seconds)

    def report(what: str) -> None:
        if what == WARM:
            say(f"serving {address.url}")

    asyncio.run(daemon.run(port.listener, report))


for _verb in (start, stop, status, run, patch, unpatch):
    daemon_app.command()(_verb)


def describe(address: DaemonAddress, occupant: Occupant) -> list[str]:
    """Describe in lines who serves a domain."""
    from play_launch.graph_daemon.control.takeover import Kind  # noqa: PLC0415

    domain = f"domain {address.domain}"
    pid = f"pid {occupant.holder.pid}" if occupant.holder else "unknown pid"
    match occupant.kind:
        case Kind.NOBODY:
            return [f"no daemon runs for {domain}"]
        case Kind.STOCK:
            return [f"ros2cli's own daemon runs for {domain} ({pid})"]
        case Kind.HUNG:
            return [f"a daemon runs for {domain}, but hangs ({pid}): {occupant.problem}"]
        case Kind.FOREIGN:
            who = occupant.holder or "something"
            return [f"{who} has the port of the daemon for {domain}: {occupant.problem}"]
        case Kind.OURS:
            return [f"the daemon runs for {domain} ({pid})", *_facts(occupant.status)]


def warn(message: str) -> None:
    """Write a warning to stderr."""
    import sys  # noqa: PLC0415

    label = "\x1b[33mwarning:\x1b[0m" if wants_colour(sys.stderr) else "warning:"
    typer.echo(f"{label} {message}", err=True, color=True)


def _facts(status: Mapping[str, Any]) -> list[str]:
    number = {name: value for name, value in status.items() if isinstance(value, int | float)}
    if not status.get("warm"):
        state = "looking around, answers begin soon"
    elif status.get("settled"):
        state = f"settled, unchanged for {number.get('unchanged_for', 0):.1f} s"
    else:
        state = f"changing, {number.get('changes_per_second', 0):.1f} times a second"
    middleware = str(status.get("rmw", ""))
    reason = status.get("transports_reason", "")
    if reason:  # which only Fast DDS has
        middleware += f", transports {status.get('transports') or 'default'} ({reason})"
    cached = number.get("cached_replies", 0)
    return [
        f"  graph       {number.get('nodes', 0)} nodes, {state}",
        f"  generation  {number.get('generation', 0)}, after {number.get('age', 0):.0f} s",
        f"  middleware  {middleware}",
        f"  requests    {number.get('requests', 0)}, {cached} of them from the cache",
        f"  clients     {number.get('connections', 0)}",
    ]


def _blind(occupant: Occupant) -> list[str]:
    """Warn of participants that the daemon will not meet."""
    met, here = occupant.status.get("participants"), occupant.status.get("participants_here")
    age = occupant.status.get("age")
    if not (isinstance(met, int) and isinstance(here, int) and isinstance(age, float)):
        return []
    # Discovery takes some seconds for each.
    if not met or met >= here or occupant.status.get("unchanged_for", 0.0) < 5.0:
        return []
    warning = f"this machine has {here} DDS participants in the domain, the daemon knows {met}"
    settings = occupant.status.get("settings", {})
    if settings.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST":
        warning += "; with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST at most 32 find one another"
    return [warning]


def _address() -> DaemonAddress:
    from play_launch.graph_daemon.contract import DomainError, daemon_address  # noqa: PLC0415

    try:
        return daemon_address()
    except DomainError as error:
        fail(f"{error} by the environment; set another one")


def _seconds(text: str) -> float:
    from play_launch.config.values import parse_duration  # noqa: PLC0415

    try:
        return parse_duration(text)
    except ValueError as error:
        fail(f"--idle-timeout: {error}")


def _require_ros() -> None:
    from play_launch.container.ros import (  # noqa: PLC0415
        MixedInstallationError,
        NotInstalledError,
        middleware_problem,
        ros_installation,
    )
    from play_launch.process.machine import (  # noqa: PLC0415
        SHARED_MEMORY_FIX,
        full_shared_memory,
        shared_memory_room,
    )

    if full := full_shared_memory(shared_memory_room()):
        fail(f"{full}; fix: {SHARED_MEMORY_FIX}")
    # Before rcl is loaded: it ends the process that asks for a middleware which is not there.
    try:
        problem = middleware_problem(ros_installation())
    except (NotInstalledError, MixedInstallationError) as error:
        fail(str(error))
    if problem is not None:
        fail(problem)
    try:
        import rclpy  # noqa: F401, PLC0415
    except ImportError as error:
        fail(
            f"ROS does not work in this Python: {error}. Source a ROS 2 installation that fits "
            "this Python, or install the wheels (pip install 'play-launch-py[jazzy]')"
        )
