"""What ``play-launch replay`` does: checks what the system needs, and runs it."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from play_launch.cli import options
from play_launch.cli.output import fail
from play_launch.deploy.notification import claim

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.deploy.notification import ServiceManager


def replay(  # noqa: PLR0917 - options, by name
    config: Annotated[
        Path,
        options.argument(
            "CONFIG", "The YAML file, or the session.mcap of a session to start again."
        ),
    ],
    arguments: options.ConfigArguments = None,
    log_dir: options.LogDir = None,
    duration: options.Duration = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    watch: Annotated[
        bool,
        typer.Option("--watch", help="Apply the configuration whenever a file of it changes."),
    ] = False,
    machine: options.Machine = "",
    detach: Annotated[
        bool,
        typer.Option(
            "--detach",
            help="With machines: end once all are up, and leave them running; a later replay "
            "of the same system adopts them.",
        ),
    ] = False,
) -> int:
    """Start a system, keep it running, and record it.

    Containers start in parallel and load their nodes; crashed ones are restarted within the limits
    of the configuration. Ctrl-C, SIGTERM or SIGHUP stops everything in order, a second one at once.
    At the end a table shows the state of each node, and where the recording is: an MCAP file for
    `ros2 bag info`, Foxglove and PlotJuggler. --json prints one object a line for each event.

    From a recording, the system starts again as it was configured then: the configuration and the
    parameter files are in it. Differences of this machine are reported.

    After a mistake in the configuration nothing is started; each problem is reported with its line.
    """
    manager = claim(os.environ)
    return bring_up(
        config,
        log_dir,
        duration,
        arguments=arguments or (),
        quiet=quiet,
        as_json=as_json,
        watch=watch,
        manager=manager,
        machine=machine,
        detach=detach,
    )


def bring_up(
    config: Path,
    log_dir: Path | None = None,
    duration: float | None = None,
    *,
    arguments: Sequence[str] = (),
    quiet: bool = False,
    as_json: bool = False,
    watch: bool = False,
    manager: ServiceManager | None = None,
    machine: str = "",
    detach: bool = False,
) -> int:
    """Run a system until its end and return the exit code; mistakes end the process."""
    if watch and is_recording(config):
        fail(f"--watch: {config} is a recording, which does not change; leave out --watch")
    loaded = _load(config, duration, arguments, machine)
    if machine:
        from play_launch.cli.check import part  # noqa: PLC0415

        loaded = part(loaded, machine)
    elif loaded.machines:
        if is_recording(config):
            names = ", ".join(loaded.machines)
            fail(f"{config} is of several machines; start one part by --machine: {names}")
        if watch:
            fail("--watch: with machines, change the running system by play-launch apply")
        from play_launch.cli.run import description_of  # noqa: PLC0415
        from play_launch.cli.run_machines import run_machines  # noqa: PLC0415

        return run_machines(
            loaded,
            description_of(loaded),
            arguments=arguments,
            log_folder=log_dir,
            as_json=as_json,
            quiet=quiet,
            detach=detach,
            manager=manager,
        )
    if detach:
        fail("--detach is for configurations with machines; a systemd unit runs a single one")
    _require_machine()
    _require_ros()
    _require_log_folder(loaded)
    from play_launch.cli.run import RunOptions, run  # noqa: PLC0415
    from play_launch.config.substitutions import parse_arguments  # noqa: PLC0415
    from play_launch.control.config_watch import Watched  # noqa: PLC0415

    return run(
        loaded,
        RunOptions(
            log_folder=log_dir,
            as_json=as_json,
            quiet=quiet,
            keeps_duration=duration is not None,
            watched=Watched(config, parse_arguments(arguments)) if watch else None,
            manager=manager,
        ),
    )


def _load(
    path: Path, duration: float | None, arguments: Sequence[str], machine: str
) -> ReplayConfig:
    from msgspec.structs import replace  # noqa: PLC0415 - after the first process

    from play_launch.config.load import load_config  # noqa: PLC0415
    from play_launch.config.problems import ConfigError  # noqa: PLC0415
    from play_launch.config.substitutions import Inputs, parse_arguments  # noqa: PLC0415

    given = parse_arguments(arguments)
    try:
        if is_recording(path):
            from play_launch.cli.recorded_system import load_recorded  # noqa: PLC0415

            loaded = load_recorded(path, given)
        else:
            loaded = load_config(path, Inputs(arguments=given), machine=machine)
    except ConfigError as error:
        fail(f"{path} cannot be used, nothing was started\n{error.for_people()}")
    return loaded if duration is None else replace(loaded, duration=duration)


def is_recording(path: Path) -> bool:
    """Whether the name is that of a recording; others are configurations."""
    return path.name.endswith((".mcap", ".mcap.active"))


def _require_log_folder(config: ReplayConfig) -> None:
    for container in config.containers:
        problem = _log_folder_problem({**os.environ, **container.environment})
        if problem and not container.attach:
            fail(f"{container.full_name} cannot run: {problem}; nothing was started")


def _log_folder_problem(environ: Mapping[str, str]) -> str:
    """Give why a process with ROS would end at its start; "" if its log files can be written."""
    from play_launch.container.ros import log_folder  # noqa: PLC0415

    folder = log_folder(environ)
    if folder is None:
        return "ROS has no folder for its log files; set HOME or ROS_LOG_DIR"
    if not folder.is_absolute():
        return ""  # it begins where the process does
    there = next(each for each in (folder, *folder.parents) if os.path.exists(each))  # noqa: PTH110 - closed ones, too
    if os.access(there, os.W_OK | os.X_OK):
        return ""
    return f"ROS cannot write log files into {folder}: {there} is not writable; set ROS_LOG_DIR"


def _require_machine() -> None:
    from play_launch.process.preflight import (  # noqa: PLC0415
        address_space_problem,
        full_shared_memory,
        proc_problem,
    )

    problem = proc_problem() or address_space_problem()
    if not problem and full_shared_memory():
        # Leftovers of Fast DDS may be what fills it.
        import asyncio  # noqa: PLC0415

        from play_launch.ros.fastdds.shared_memory import sweep_shared_memory  # noqa: PLC0415

        with contextlib.suppress(OSError):
            asyncio.run(sweep_shared_memory())
        problem = full_shared_memory()
    if problem:
        fail(f"nothing was started: {problem}")


def _require_ros() -> None:
    from play_launch.config.values import domain_problem  # noqa: PLC0415
    from play_launch.container.ros import (  # noqa: PLC0415
        component_container,
        middleware_problem,
        rclpy_problem,
        ros_installation,
        spawn_guard,
    )

    problem = domain_problem(os.environ.get("ROS_DOMAIN_ID", ""))
    if problem is not None:
        fail(f"{problem} by the environment; set another one")
    problem = middleware_problem(ros_installation())
    component_container()
    spawn_guard()
    if problem is not None:
        fail(problem)
    # Imported when the first container runs: it takes as long as a container's start.
    problem = rclpy_problem()
    if problem is not None:
        fail(
            f"ROS does not work in this Python: {problem}. Source a ROS 2 installation that fits "
            "this Python, or install the wheels (pip install 'play-launch-py[jazzy]')"
        )
