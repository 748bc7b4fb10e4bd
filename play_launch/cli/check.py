"""What ``play-launch check`` does: finds mistakes in a configuration without starting anything."""

from __future__ import annotations

import json
import math
import os
from typing import TYPE_CHECKING, Annotated, Any

import typer
from msgspec.structs import asdict

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import counted, fail, report, say, warn
from play_launch.config.dependency import OnTimeout, StartRule
from play_launch.config.machines import discovery_problems, part_of
from play_launch.control.protocol import PROTOCOL

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.config.dependency import Dependency
    from play_launch.config.model import ReplayConfig


def check(  # noqa: PLR0917 - options, by name
    config: options.ConfigFile,
    arguments: options.ConfigArguments = None,
    as_json: options.Json = False,
    machine: options.Machine = "",
    graph: Annotated[
        bool, typer.Option("--graph", help="Print what waits for what (depends_on).")
    ] = False,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Print the resolved configuration, and command and environment of each process.",
        ),
    ] = False,
) -> int:
    """Find mistakes in a configuration; start nothing.

    Each mistake is reported as `file:line:column: path: message`. Exits with 2 if there is one,
    with 1 if --explain finds what cannot be started or loaded. --json prints the problems and
    the resolved configuration.
    """
    from play_launch.config.load import load_config  # noqa: PLC0415
    from play_launch.config.problems import ConfigError  # noqa: PLC0415
    from play_launch.config.substitutions import Inputs, parse_arguments  # noqa: PLC0415

    if explain and graph and not as_json:
        fail("--graph and --explain: only --json prints both")
    try:
        loaded = load_config(
            config, Inputs(arguments=parse_arguments(arguments or ())), machine=machine
        )
    except ConfigError as error:
        if as_json:
            problems = [asdict(problem) for problem in error.problems]
            say(json.dumps({"valid": False, "problems": problems}, ensure_ascii=False))
        else:
            report(f"{config} cannot be used\n{error.for_people()}")
        return ExitCode.USAGE
    if machine:
        loaded = part(loaded, machine)
    environs = {each.name: os.environ for each in loaded.machines.values() if each.local}
    notes = [] if machine else discovery_problems(loaded, environs)
    started: list[dict[str, Any]] = []
    explained: dict[str, Any] = {}
    if explain:
        from play_launch.cli.explain_start import helpers, processes  # noqa: PLC0415

        started = processes(loaded)
        explained = {"processes": started, "helpers": helpers(loaded)}
    if as_json:
        from play_launch.recording.environment import OURSELVES, package_version  # noqa: PLC0415

        values: dict[str, Any] = {"valid": True, "problems": [], "config": _resolved(loaded)}
        values |= {"protocol": PROTOCOL, "version": package_version(OURSELVES), **explained}
        if graph:
            values["graph"] = _graph_values(loaded)
        if loaded.machines:
            values["warnings"] = notes
        say(json.dumps(values, ensure_ascii=False))
    elif graph:
        say(_graph_text(loaded))
    elif explain:
        from play_launch.cli.explain_start import as_text  # noqa: PLC0415

        say(as_text(_resolved(loaded), started, explained["helpers"]))
    else:
        say(f"{config}: {describe(loaded)}")
        for name in () if machine else loaded.machines:
            say(f"  {name}: {describe(part_of(loaded, name))}")
    if not as_json:
        for text in notes:
            warn(text)
    failing = [(each, "started") for each in started if each["problem"]]
    failing += [(each, "loaded") for one in started for each in one.get("unloadable", ())]
    for each, what in failing:
        report(f"{each['name']} ({each['place']}) cannot be {what}: {each['problem']}")
    return ExitCode.NODE_FAILED if failing else ExitCode.OK


def part(config: ReplayConfig, machine: str) -> ReplayConfig:
    """Return the part of a machine; a mistake ends the process."""
    if machine not in config.machines:
        known = ", ".join(config.machines) or "none"
        fail(f"--machine: there is no machine {machine}; the configuration declares: {known}")
    return part_of(config, machine)


def _resolved(config: ReplayConfig) -> dict[str, object]:
    from play_launch.recording.resolved_form import resolved_form  # noqa: PLC0415

    return resolved_form(config)


def describe(config: ReplayConfig) -> str:
    """Describe the size of a system: ``2 containers with 7 nodes, 1 process``."""
    nodes = sum(len(container.composable_nodes) for container in config.containers)
    parts = []
    if config.containers or not config.nodes:
        containers = counted(len(config.containers), "container")
        parts.append(f"{containers} with {counted(nodes, 'node')}")
    if config.nodes:
        parts.append(counted(len(config.nodes), "process"))
    return ", ".join(parts)


# The graph: what waits for what.


def _graph_text(config: ReplayConfig) -> str:
    """Give each unit a line, in the order of the file, and what it waits for below it."""
    lines = []
    for name, container, rule in _start_units(config):
        indentation = "  " if container else ""
        waits = [f"waits for {each}{_limit(each)}" for each in rule.dependencies]
        if rule.delay:
            waits.append(f"waits {rule.delay:g} s")
        lines.append(f"{indentation}{name.removeprefix(f'{container}:')}")
        lines += [f"{indentation}    {wait}" for wait in waits]
    return "\n".join(lines)


def _graph_values(config: ReplayConfig) -> dict[str, object]:
    """Give the units and what they wait for; ``timeout`` is seconds, null for any time."""
    units = list(_start_units(config))
    return {
        "units": [
            {"unit": name, "container": container or None, "delay": rule.delay}
            for name, container, rule in units
        ],
        "dependencies": [
            {
                "of": name,
                "condition": str(dependency.condition),
                "on": dependency.unit or None,
                "subject": dependency.subject or None,
                "timeout": dependency.timeout if math.isfinite(dependency.timeout) else None,
                "on_timeout": str(dependency.on_timeout),
            }
            for name, _, rule in units
            for dependency in rule.dependencies
        ],
    }


def _start_units(config: ReplayConfig) -> Iterator[tuple[str, str, StartRule]]:
    """Yield each unit, the container of a node (else empty), and what the unit waits for."""
    for member, nodes in config.units.items():
        for unit in (member, *nodes):
            container = "" if unit == member else member
            yield unit, container, config.start_rules.get(unit, StartRule())


def _limit(dependency: Dependency) -> str:
    limit = f", at most {dependency.timeout:g} s" if math.isfinite(dependency.timeout) else ""
    starts = dependency.on_timeout is OnTimeout.START
    return f"{limit}, else it starts all the same" if starts else limit
