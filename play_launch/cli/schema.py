"""``play-launch schema``: what editors need to know about configurations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from play_launch.cli.output import say

SCHEMA_FILE = Path(__file__).resolve().parents[1] / "config" / "config.schema.json"
"""The schema as it is installed."""


def schema(
    show_path: Annotated[
        bool,
        typer.Option("--path", help="Print the path of the installed file, for editors."),
    ] = False,
) -> None:
    """Print the JSON Schema of configurations.

    Editors with the YAML language server read its path from the first line of a file:
    `# yaml-language-server: $schema=PATH`. `play-launch init` writes that line.
    """
    say(str(SCHEMA_FILE) if show_path else schema_text().rstrip("\n"))


def schema_text() -> str:
    """Return the schema as the installed file has it."""
    from play_launch.config.schema_export import json_schema  # noqa: PLC0415

    return json.dumps(json_schema(), indent=1, ensure_ascii=False) + "\n"
