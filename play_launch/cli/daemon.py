"""``play-launch daemon``: the daemon that answers ros2cli's questions about the graph."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import counted, fail, say, warn
from play_launch.graph_daemon.contract import WARM, daemon_address

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.graph_daemon.contract import DaemonAddress
    from play_launch.graph_daemon.port import PortOwner

daemon = typer.Typer(
    help="The graph daemon: answers 'ros2 node list' and the like at the address of ros2cli's own "
    "daemon, and stays responsive while many nodes start.",
    no_args_is_help=True,
    **options.PLAIN,
)

IdleTimeout = Annotated[
    float,
    typer.Option(
        parser=options.duration_or_zero,
        help="Exit after this time without a request: 2h, 30min; 0s for never.",
        metavar="TIME",
        show_default=False,
    ),
]
_NOT_RUNNING = ExitCode.NODE_FAILED


def start(
    restart: Annotated[
        bool, typer.Option("--restart", help="Replace a running one, for new settings.")
    ] = False,
    idle_timeout: IdleTimeout = 7200.0,
) -> None:
    """Start the daemon of this ROS_DOMAIN_ID.

    Returns when the daemon knows the graph. A running daemon of ros2cli is replaced. A running
    daemon of play-launch is kept, with a warning where its settings are not yours.
    """
    address = daemon_address()
    _require_ros()
    from play_launch.graph_daemon.start_stop import start_daemon  # noqa: PLC0415

    started = start_daemon(address, idle_timeout=idle_timeout, restart=restart, notify=warn)
    if started.process is not None:
        started.process.returncode = 0  # no warning that it still runs
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
    """Stop the daemon of this ROS_DOMAIN_ID.

    It may be ros2cli's own one.
    """
    address = daemon_address()
    from play_launch.graph_daemon.port import OwnerKind, stop_daemon  # noqa: PLC0415

    owner = stop_daemon(address)
    if owner.kind is OwnerKind.FREE:
        say(f"no daemon runs for domain {address.domain}")
    else:
        whose = "ros2cli's daemon" if owner.kind is OwnerKind.STOCK else "the daemon"
        say(f"{whose} of domain {address.domain} was stopped")


def status(as_json: options.Json = False) -> None:
    """Show the daemon of this ROS_DOMAIN_ID.

    Warns where its settings are not those of your environment: then it sees another graph than
    your programs. Exits with 1 when none runs.
    """
    import json  # noqa: PLC0415

    from play_launch.graph_daemon.port import OwnerKind, find_owner, settings_warnings  # noqa: PLC0415

    address = daemon_address()
    owner = find_owner(address)
    warnings = settings_warnings(owner, os.environ)
    if as_json:
        kinds = {OwnerKind.OURS: "play_launch", OwnerKind.STOCK: "ros2cli", OwnerKind.FREE: None}
        values = {
            "running": owner.kind in {OwnerKind.OURS, OwnerKind.STOCK},
            "daemon": kinds.get(owner.kind, "other"),
            "domain": address.domain,
            "url": address.url,
            "pid": owner.pid,
            "problem": owner.problem,
            "warnings": warnings,
            **owner.status,
        }
        say(json.dumps(values, ensure_ascii=False))
    else:
        for line in describe(address, owner):
            say(line)
        for warning in warnings:
            warn(warning)
    if owner.kind not in {OwnerKind.OURS, OwnerKind.STOCK}:
        raise typer.Exit(_NOT_RUNNING)


def run(idle_timeout: IdleTimeout = 0.0) -> None:
    """Run the daemon in the foreground, until Ctrl-C.

    For services and containers.
    """
    address = daemon_address()
    _require_ros()
    import asyncio  # noqa: PLC0415
    import logging  # noqa: PLC0415

    from play_launch.graph_daemon.daemon import Daemon  # noqa: PLC0415
    from play_launch.graph_daemon.port import acquire  # noqa: PLC0415

    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    port = acquire(address, notify=warn)
    if port.listener is None:
        fail(
            f"the daemon of domain {address.domain} is running already (pid {port.pid})",
            ExitCode.NODE_FAILED,
        )
    for message in port.messages:
        say(message)
    server = Daemon(address, idle_timeout=idle_timeout)

    def report(what: str) -> None:
        if what == WARM:
            say(f"serving {address.url}")

    asyncio.run(server.run(port.listener, report))


_CHANGES = (
    "listens with a queue of 512 connections, not 5",
    "no client that is silent, slow or does not read delays others; 10 s for each",
    "answers about the graph are given again for 200 ms",
    "the network's interfaces are listed every 30 s, not at each call",
    "the machine's own addresses are remembered for 30 s",
    "web pages are refused",
    "calls are not printed",
    "the loop wakes every 200 ms and handles signals",
)
_RESTART = (
    "A daemon that runs already keeps its code: `ros2 daemon stop`; the next ros2 starts a new one"
)

_DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Print what would be done, and change nothing.")
]
_Into = Annotated[
    Path | None,
    typer.Option(
        "--into",
        metavar="FOLDER",
        help="Folder of packages that the Python of ros2 reads; default: your own, or that of "
        "its virtual environment.",
    ),
]


def patch(dry_run: _DryRun = False, into: _Into = None) -> None:
    """Improve the daemon of an installed ros2cli.

    It stays responsive while many nodes start. For systems that must keep that daemon;
    'play-launch daemon start' is the better one. No file of ros2cli is changed: a package is
    written beside it, which changes the daemon when Python imports it. 'play-launch daemon unpatch'
    removes it.
    """
    # Only when it runs: help comes up faster.
    from play_launch.graph_daemon.patch import default_folder, write  # noqa: PLC0415

    folder = into or default_folder()
    if not dry_run:
        write(folder)
    say("would change in ros2cli's daemon:" if dry_run else "changes in ros2cli's daemon:")
    for change in _CHANGES:
        say(f"  {change}")
    say(f"{'would be written' if dry_run else 'written'} to {folder}")
    if not dry_run:
        say(_RESTART)


def unpatch(dry_run: _DryRun = False, into: _Into = None) -> None:
    """Remove what 'play-launch daemon patch' has written."""
    from play_launch.graph_daemon.patch import (  # noqa: PLC0415
        default_folder,
        is_written,
        remove,
    )

    folder = into or default_folder()
    present = is_written(folder) if dry_run else remove(folder)
    if not present:
        say(f"no patch in {folder}; nothing to do")
        return
    say(f"{'would remove' if dry_run else 'removed'} the patch from {folder}")
    if not dry_run:
        say(_RESTART)


for _verb in (start, stop, status, run, patch, unpatch):
    daemon.command()(_verb)


def describe(address: DaemonAddress, owner: PortOwner) -> list[str]:
    from play_launch.graph_daemon.port import OwnerKind  # noqa: PLC0415

    domain = f"domain {address.domain}"
    pid = f"pid {owner.pid}" if owner.pid else "unknown pid"
    match owner.kind:
        case OwnerKind.FREE:
            return [f"no daemon runs for {domain}"]
        case OwnerKind.STOCK:
            return [f"ros2cli's own daemon runs for {domain} ({pid})"]
        case OwnerKind.OTHER:
            return [f"{owner} has the port of the daemon for {domain}: {owner.problem}"]
        case OwnerKind.OURS:
            return [f"the daemon runs for {domain} ({pid})", *_facts(owner.status)]


def _facts(status: Mapping[str, Any]) -> list[str]:
    number = {name: value for name, value in status.items() if isinstance(value, int | float)}
    if not status.get("warm"):
        state = "warming up"
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
        f"  graph       {counted(int(number.get('nodes', 0)), 'node')}, {state}",
        f"  generation  {number.get('generation', 0)}, after {number.get('age', 0):.0f} s",
        f"  middleware  {middleware}",
        f"  requests    {number.get('requests', 0)}, {cached} of them from the cache",
        f"  clients     {number.get('connections', 0)}",
    ]


def _require_ros() -> None:
    from play_launch.container.ros import middleware_problem, ros_installation  # noqa: PLC0415
    from play_launch.process.preflight import full_shared_memory  # noqa: PLC0415

    if full := full_shared_memory():
        fail(full)
    # Before rcl is loaded: it ends the process that asks for a middleware which is not there.
    problem = middleware_problem(ros_installation())
    if problem is not None:
        fail(problem)
    try:
        import rclpy  # noqa: F401, PLC0415
    except ImportError as error:
        fail(
            f"ROS does not work in this Python: {error}. Source a ROS 2 installation that fits "
            "this Python, or install the wheels (pip install 'play-launch-py[jazzy]')"
        )
