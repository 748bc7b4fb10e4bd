"""Writing of a configuration that was converted, to a file or to stdout."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from msgspec.structs import asdict

from play_launch.cli.output import fail, is_standard_output, note, say, write_file
from play_launch.cli.target import report_losses, sizes
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.launch_files.configuration.write import Written


def write_config(
    made: Written,
    output: Path | None,
    *,
    strict: bool,
    as_json: bool,
    more: Mapping[str, object] | None = None,
) -> ExitCode:
    """Write the configuration, report what it does not say, and return the exit code.

    Without `output` it goes to stdout. With `strict` nothing is written when anything was lost.
    `more` goes into the JSON.
    """
    is_refused = strict and made.lost > 0
    if output is not None and is_standard_output(output):
        output = None
    if output is not None and not is_refused:
        for path, content in made.files.items():
            try:
                path.parent.mkdir(exist_ok=True)
            except OSError as error:
                fail(f"{path.parent} cannot be made: {error.strerror}", ExitCode.NODE_FAILED)
            write_file(path, content)
        write_file(output, made.text)
    if as_json:
        say(json.dumps({**_values(made, output), **(more or {})}, ensure_ascii=False))
    else:
        if output is None and not is_refused:
            say(made.text.rstrip("\n"))
        report_losses(made)
        note(sizes(made))
    return ExitCode.USAGE if made.problems or is_refused else ExitCode.OK


def _values(made: Written, output: Path | None) -> dict[str, object]:
    return {
        "output": None if output is None else str(output),
        "config": made.text if output is None else None,
        "copies": [str(path) for path in made.files],
        "containers": made.containers,
        "composable_nodes": made.composable_nodes,
        "processes": made.processes,
        "lost": [_loss(each) for each in made.losses if not each.is_note],
        "notes": [_loss(each) for each in made.losses if each.is_note],
        "problems": [asdict(problem) for problem in made.problems],
    }


def _loss(loss: object) -> dict[str, str]:
    return {"where": str(getattr(loss, "where", "")), "what": str(getattr(loss, "what", ""))}
