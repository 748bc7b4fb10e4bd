"""What ``play-launch check`` does: finds mistakes in a configuration without starting anything."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from msgspec.structs import asdict

from play_launch.cli.failure import report
from play_launch.cli.show.terminal import say
from play_launch.core.exit_code import ExitCode

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.config import ReplayConfig


def find_mistakes(config: Path, *, as_json: bool = False) -> int:
    """Report every mistake in a configuration and return the exit code."""
    from play_launch.config import ConfigError, load_config  # noqa: PLC0415

    try:
        loaded = load_config(config)
    except ConfigError as error:
        if as_json:
            problems = [asdict(problem) for problem in error.problems]
            say(json.dumps({"valid": False, "problems": problems}, ensure_ascii=False))
        else:
            report(f"{config} cannot be used\n{error.for_people()}")
        return ExitCode.USAGE
    if as_json:
        from play_launch.config.description import describe as describe_values  # noqa: PLC0415

        values = {"valid": True, "problems": [], "config": describe_values(loaded)}
        say(json.dumps(values, ensure_ascii=False))
    else:
        say(f"{config}: {describe(loaded)}")
    return ExitCode.OK


def describe(config: ReplayConfig) -> str:
    """Say how big a system is: ``2 containers with 7 nodes, 1 process``."""
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
