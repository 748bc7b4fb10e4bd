"""What ``play-launch check --explain`` prints: what is read, and each process that would start."""

from __future__ import annotations

import functools
import json
import os
import shlex
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec.structs import replace

from play_launch.config.model import ContainerConfig
from play_launch.config.substitutions import ament_prefixes
from play_launch.container.channel import CONTROL_FD_VARIABLE
from play_launch.container.command import (
    Command,
    Machine,
    NotInPackageError,
    allocator_for,
    component_library,
    container_command,
    is_own,
    process_command,
    shared_processes,
    stays_alone,
)
from play_launch.container.environment import caller_environment, child_environment
from play_launch.container.parameter_files import ParameterFileError, parameter_file_of
from play_launch.container.ros import component_container, ros_installation, topic_recorder
from play_launch.process.guard import SpawnError, check_program
from play_launch.process.kin import MEMBER_VARIABLE, mark_for
from play_launch.recording.environment import REDACTED, is_secret
from play_launch.recording.resolved_form import taken_secrets, without
from play_launch.recording.topic_recorder.supervision import recorder_argv

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from play_launch.config.model import ProcessConfig, ReplayConfig
    from play_launch.container.command import SharedKey

_RECORDER: Final = "topic recorder"
_PARAMETER_FILE: Final = Path("(parameter file)")
"""Stands in a command line for the file, which is written for each run."""
_DESCRIPTOR: Final = "(descriptor)"
"""Stands for the number of a descriptor that the process inherits."""


class _Process(NamedTuple):
    name: str
    kind: str
    place: str
    command: Command | None
    problem: str = ""
    parameter_file: str | None = None
    alone: str | None = None
    """Why `consolidate` gives it no process with others; None: it was not asked for."""
    shared: SharedKey | None = None
    """Identifies the process that it shares."""
    unloadable: tuple[dict[str, str], ...] = ()
    """Its components that are not installed: name, place, problem. Where other containers look for
    theirs is up to them."""


def processes(config: ReplayConfig) -> list[dict[str, Any]]:
    """Give each process that `replay` starts, without secrets, as values for JSON.

    What cannot be started has a ``problem``, and containers of components that are not installed
    have them in ``unloadable``. Mistakes of the installation end the process.
    """
    ros = ros_installation()
    container, recorder = component_container(), topic_recorder()
    machine = Machine(ros, container, os.environ, allocator_for(config).library)
    caller = caller_environment(os.environ, ros)
    secrets = taken_secrets(config)
    attached = {each.full_name for each in config.containers if each.attach}
    started = (each for each in config.members if each.full_name not in attached)
    shares = shared_processes(config, machine)
    found = [_member(each, machine, config.stop.ask, shares) for each in started]
    if config.record.ros or config.expect:
        argv = recorder_argv(recorder, config, _DESCRIPTOR, "(clock)")
        environment = child_environment(os.environ, ros, config.environment)
        found.append(_Process("", _RECORDER, "", Command(argv, environment)))
    return [_values(process, caller, secrets) | _sharing(process, found) for process in found]


def helpers(config: ReplayConfig) -> list[str]:
    """Name what `replay` starts for itself, each with what it is for."""
    found = ["spawn_guard: the parent of containers and processes, ends them with the supervisor"]
    if config.record.ros:
        found.append("spawn_guard: the parent of the topic recorder")
    if config.graph_daemon:
        found.append("play_launch.graph_daemon: unless one serves the domain; outlives the session")
    found.append(
        "play_launch.postmortem.archive: completes or removes earlier recordings, after bring-up"
    )
    found.append(
        "play_launch.ros.fastdds: removes what is left in shared memory, after a SIGKILL of replay"
    )
    return found


def as_text(
    values: Mapping[str, object], started: list[dict[str, Any]], besides: Iterable[str]
) -> str:
    """Lay a resolved configuration out for people: YAML, shell commands, and the `helpers`."""
    import yaml  # noqa: PLC0415 - not for JSON

    text = yaml.safe_dump(dict(values), sort_keys=False, allow_unicode=True, width=float("inf"))
    commands = ["\n".join([*_lines(each), ""]) for each in started]
    own = ["# and for play-launch itself", *(f"#   {_remark(each)[2:]}" for each in besides)]
    return "\n".join([text, *commands, *own])


def _member(
    config: ContainerConfig | ProcessConfig,
    machine: Machine,
    ask: float,
    shares: Mapping[str, SharedKey],
) -> _Process:
    kind = "container" if isinstance(config, ContainerConfig) else "process"
    process = _Process(config.full_name, kind, f"{config.file}:{config.line}", None)
    try:
        text = parameter_file_of(config)
        file = None if text is None else _PARAMETER_FILE
        if isinstance(config, ContainerConfig):
            command = container_command(config, machine, file, ask=ask)
        else:
            command = process_command(config, machine, file)
    except (ParameterFileError, NotInPackageError, ValueError) as error:
        return process._replace(problem=str(error))
    variables = {MEMBER_VARIABLE: mark_for("(pid)", config.full_name)}
    if isinstance(config, ContainerConfig) and is_own(config):
        variables[CONTROL_FD_VARIABLE] = _DESCRIPTOR
        missing = tuple(_unloadable(config, tuple(ament_prefixes(command.environment))))
        process = process._replace(shared=shares.get(config.full_name), unloadable=missing)
        if config.consolidate and process.shared is None:
            process = process._replace(alone=stays_alone(config))
    command = replace(command, environment={**command.environment, **variables})
    try:
        check_program(command.argv, command.environment, command.cwd)
    except OSError as error:
        process = process._replace(problem=str(SpawnError.of(command.argv, error)))
    return process._replace(command=command, parameter_file=text)


def _unloadable(config: ContainerConfig, prefixes: tuple[Path, ...]) -> Iterator[dict[str, str]]:
    for node in config.composable_nodes:
        if problem := _component_problem(node.package, node.plugin, prefixes):
            place = f"{node.file}:{node.line}"
            yield {"name": node.declared_full_name, "place": place, "problem": problem}


@functools.cache
def _component_problem(package: str, plugin: str, prefixes: tuple[Path, ...]) -> str:
    try:
        component_library(package, plugin, prefixes)
    except NotInPackageError as error:
        return str(error)
    return ""


def _values(
    process: _Process, caller: Mapping[str, str], secrets: Collection[str]
) -> dict[str, Any]:
    command = process.command
    values: dict[str, Any] = {
        "name": process.name or None,
        "kind": process.kind,
        "place": process.place or None,
        "problem": process.problem or None,
    }
    if command is None:
        return values
    changed = {
        name: REDACTED if is_secret(name, value) else value
        for name, value in command.environment.items()
        if caller.get(name) != value
    }
    return values | {
        "argv": without(command.argv, secrets),
        "environment": without(changed, secrets),
        "unset": sorted(caller.keys() - command.environment.keys()),
        "cwd": str(command.cwd or _here()),
        "emulate_tty": command.emulate_tty,
        "resources": command.resources.described(),
        "parameter_file": without(process.parameter_file, secrets),
        "unloadable": process.unloadable,
    }


def _sharing(process: _Process, all_: Iterable[_Process]) -> dict[str, object]:
    """Give the containers that have one process with this one, or why none has."""
    if process.alone is not None:
        return {"alone": process.alone}
    if process.shared is None:
        return {}
    like = [each.name for each in all_ if each.shared == process.shared and each is not process]
    return {"shares_process_with": like}


def _here() -> str:
    with suppress(FileNotFoundError):
        return str(Path.cwd())
    return ""


def _lines(process: Mapping[str, Any]) -> Iterator[str]:
    place = f", {process['place']}" if process["place"] else ""
    yield _remark(f"{process['name'] or 'for the recording'} ({process['kind']}{place})")
    if process["problem"]:
        yield _remark(f"cannot be started: {process['problem']}")
    if "argv" not in process:
        return
    for each in process["unloadable"]:
        yield _remark(f"cannot load {each['name']}: {each['problem']}")
    if others := process.get("shares_process_with"):
        yield _remark(f"has one process with {', '.join(others)} (consolidate)")
        yield _remark("  what poisons it, such as a lock of a dead node, ends all of them")
    elif "shares_process_with" in process:
        yield _remark("has its process with no other container (consolidate)")
    if process.get("alone"):
        yield _remark(f"has a process of its own in spite of consolidate: {process['alone']}")
    if process["emulate_tty"]:
        yield "# writes to terminals (emulate_tty)"
    if process["resources"]:
        yield _remark(f"asks the kernel for resources: {json.dumps(process['resources'])}")
    if process["parameter_file"]:
        yield "# parameter file:"
        yield from (_remark(f"  {line}") for line in process["parameter_file"].splitlines())
    yield f"cd {_quoted(process['cwd'])} && \\"
    unset = "".join(f" -u {_quoted(name)}" for name in process["unset"])
    yield f"env{unset} \\"
    for name, value in process["environment"].items():
        yield f"  {_quoted(name)}={_quoted(value)} \\"
    yield f"  {' '.join(map(_quoted, process['argv']))}"


def _remark(text: str) -> str:
    return f"# {text if text.isprintable() else ascii(text)[1:-1]}"


def _quoted(text: str) -> str:
    """Quote for bash; what would disturb a terminal is written by its number."""
    if text.isprintable():
        return shlex.quote(text)
    written = (
        each
        if each.isprintable() and each not in "\\'"
        else "".join(f"\\x{byte:02x}" for byte in os.fsencode(each))
        for each in text
    )
    return f"$'{''.join(written)}'"
