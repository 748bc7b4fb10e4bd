"""``play-launch import``: a system that another program has dumped becomes a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from play_launch.cli import options
from play_launch.cli.target import write_config


def import_(
    file: Annotated[Path, options.argument("FILE", "A record.json or a system_model.yaml.")],
    output: options.Output = None,
    stock: Annotated[
        bool,
        typer.Option("--stock", help="Containers keep their own programs (stock)."),
    ] = False,
    strict: options.Strict = False,
    as_json: options.Json = False,
) -> int:
    """Convert a dump of the program play_launch (Rust) to a configuration.

    What cannot be converted is reported, a line each. Exits with 2 if the result has mistakes that
    `check` finds, with --strict also if anything was lost.
    """
    from play_launch.launch_files.importing import read  # noqa: PLC0415 - not for other verbs

    return write_config(
        read.import_system(file, stock=stock), output, strict=strict, as_json=as_json
    )
