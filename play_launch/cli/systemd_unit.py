"""``play-launch systemd-unit``: a unit by which systemd runs a system."""

from __future__ import annotations

import os
import pwd
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from play_launch.cli import options
from play_launch.cli.output import fail, is_standard_output, note, say, write_file

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.config.model import ReplayConfig

_COMMAND = "play-launch"


def systemd_unit(
    config: options.ConfigFile,
    arguments: options.ConfigArguments = None,
    output: options.Output = None,
    for_user: Annotated[
        bool,
        typer.Option("--user", help="For systemctl --user."),
    ] = False,
    log_dir: options.LogDir = None,
) -> None:
    """Write a systemd unit that starts, supervises and stops a system.

    Run this as the user, in the folder and in the shell in which `play-launch replay CONFIG` works:
    the unit contains this user, this folder, and the ROS variables of the shell.
    """
    from play_launch.deploy.unit import ServiceUnit, unit_text  # noqa: PLC0415

    loaded = _loaded(config.absolute(), arguments or ())
    environment, left_out = _environment(loaded)
    service = ServiceUnit(
        config=loaded,
        program=program(),
        folder=Path.cwd(),
        user="" if for_user else _user(),
        environment=environment,
        left_out=left_out,
        arguments=tuple(arguments or ()),
        log_dir=None if log_dir is None else log_dir.absolute(),
    )
    _require_plain(service.program, service.config.source, service.folder)
    text = unit_text(service)
    for name in left_out:
        note(f"note: the variable {name} is not in the unit, see the comment in it")
    if output is None or is_standard_output(output):
        say(text.rstrip("\n"))
        return
    write_file(output, text)
    say(f"{output} is written; to install it, see the comment at its top")


def _loaded(path: Path, arguments: Sequence[str]) -> ReplayConfig:
    from play_launch.config.load import load_config  # noqa: PLC0415
    from play_launch.config.problems import ConfigError  # noqa: PLC0415
    from play_launch.config.substitutions import Inputs, parse_arguments  # noqa: PLC0415

    try:
        return load_config(path, Inputs(arguments=parse_arguments(arguments)))
    except ConfigError as error:
        fail(f"{path} cannot be used, no unit was written\n{error.for_people()}")


def program() -> Path:
    started = Path(sys.argv[0])
    if started.name == _COMMAND and started.is_file():
        return started.absolute()
    beside = Path(sys.executable).with_name(_COMMAND)
    found = str(beside) if beside.is_file() else shutil.which(_COMMAND)
    if found is None:
        fail("the command play-launch is not in PATH; install play-launch-py as a package")
    return Path(found).absolute()


def _user() -> str:
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return str(os.getuid())


def _environment(config: ReplayConfig) -> tuple[dict[str, str], tuple[str, ...]]:
    from play_launch.container.environment import caller_environment  # noqa: PLC0415
    from play_launch.container.ros import ros_installation  # noqa: PLC0415
    from play_launch.deploy.unit import carried  # noqa: PLC0415

    environ = caller_environment(os.environ, ros_installation())
    return carried(environ, config.taken.variables)


def _require_plain(*paths: Path) -> None:
    from play_launch.deploy.unit import is_acceptable  # noqa: PLC0415

    for path in paths:
        if not is_acceptable(str(path)) or any(each in str(path) for each in "\n\t\\\"'"):
            fail(f"{str(path)!r}: systemd accepts no path with quotes or backslashes")
