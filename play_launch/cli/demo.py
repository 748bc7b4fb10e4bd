"""``play-launch demo``: the demo system, which needs no checkout."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from play_launch.cli import options
from play_launch.cli.replay import bring_up

CONFIG: Final = Path(__file__).with_name("demo.yaml")


def demo(
    seconds: Annotated[
        float,
        typer.Option(
            "--seconds",
            parser=options.duration,
            metavar="TIME",
            help="Stop after this time: 30, 2min.",
            show_default="10",
        ),
    ] = 10.0,
    log_dir: options.LogDir = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> int:
    """Start the demo system: three containers with eight nodes, on this machine only.

    It is `replay` of a configuration that is part of the package.
    """
    return bring_up(CONFIG, log_dir, seconds, quiet=quiet, as_json=as_json)
