"""What ``play-launch check`` does: finds mistakes in a configuration without starting anything."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer
from msgspec.structs import asdict

from play_launch.cli import options
from play_launch.cli.output import fail, report, say
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from play_launch.config.model import ReplayConfig


class GraphForm(StrEnum):
    """How ``check --graph`` writes the graph."""

    TEXT = "text"
    MERMAID = "mermaid"


def check(  # noqa: PLR0917 - options, by name
    config: options.ConfigFile,
    arguments: options.ConfigArguments = None,
    as_json: options.Json = False,
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
    form: Annotated[
        GraphForm | None,
        typer.Option("--format", help="Of the graph: text (default), or mermaid, a flow chart."),
    ] = None,
) -> int:
    """Find mistakes in a configuration; start nothing.

    Each mistake is reported as `file:line:column: path: message`. Exits with 2 if there is one,
    with 1 if --explain finds a process that cannot be started. --json prints the problems and the
    resolved configuration.
    """
    from play_launch.config.load import load_config  # noqa: PLC0415
    from play_launch.config.problems import ConfigError  # noqa: PLC0415
    from play_launch.config.substitutions import (  # noqa: PLC0415
        Inputs,
        parse_arguments,
    )

    if explain and graph and not as_json:
        fail("--graph and --explain: only --json prints both")
    try:
        given = parse_arguments(arguments or ())
    except ValueError as error:
        fail(str(error))
    try:
        loaded = load_config(config, Inputs(arguments=given))
    except ConfigError as error:
        if as_json:
            problems = [asdict(problem) for problem in error.problems]
            say(json.dumps({"valid": False, "problems": problems}, ensure_ascii=False))
        else:
            report(f"{config} cannot be used\n{error.for_people()}")
        return ExitCode.USAGE
    started = _started(loaded) if explain else []
    if as_json:
        values: dict[str, object] = {"valid": True, "problems": [], "config": _resolved(loaded)}
        if graph:
            from play_launch.cli.draw_graph import as_values  # noqa: PLC0415

            values["graph"] = as_values(loaded)
        if explain:
            from play_launch.cli.explain_start import helpers  # noqa: PLC0415

            values["processes"] = started
            values["helpers"] = helpers(loaded)
        say(json.dumps(values, ensure_ascii=False))
    elif graph:
        from play_launch.cli.draw_graph import as_mermaid, as_text  # noqa: PLC0415

        say((as_mermaid if form is GraphForm.MERMAID else as_text)(loaded))
    elif explain:
        from play_launch.cli.explain_start import as_text as commands  # noqa: PLC0415
        from play_launch.cli.explain_start import helpers  # noqa: PLC0415

        say(commands(_resolved(loaded), started, helpers(loaded)))
    else:
        say(f"{config}: {describe(loaded)}")
    problems = [each for each in started if each["problem"]]
    for each in problems:
        report(f"{each['name']} ({each['place']}) cannot be started: {each['problem']}")
    return ExitCode.NODE_FAILED if problems else ExitCode.OK


def _resolved(config: ReplayConfig) -> dict[str, object]:
    from play_launch.recording.resolved_form import resolved_form  # noqa: PLC0415

    return resolved_form(config)


def _started(config: ReplayConfig) -> list[dict[str, Any]]:
    from play_launch.cli.explain_start import processes  # noqa: PLC0415

    return processes(config)


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


def counted(number: int, noun: str) -> str:
    """``1 node``, ``2 nodes``, ``3 processes``."""
    plural = f"{noun}es" if noun.endswith("s") else f"{noun}s"
    return f"{number} {noun if number == 1 else plural}"
