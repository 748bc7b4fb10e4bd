"""``play-launch init``, ``play-launch schema``: a configuration to begin with, and the schema."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Final

import typer

from play_launch import ExitCode
from play_launch.cli.output import fail, is_standard_output, say

SCHEMA_FILE = Path(__file__).resolve().parents[1] / "config" / "config.schema.json"
"""The schema as it is installed."""
_STARTER: Final = Path(__file__).with_name("starter.yaml")


def init(
    file: Annotated[Path, typer.Argument(metavar="[FILE]", help="The file to write.")] = Path(
        "robot.yaml"
    ),
) -> None:
    """Write a commented configuration to begin with; an existing file is kept."""
    is_stdout = is_standard_output(file)
    values = {"SCHEMA": str(SCHEMA_FILE), "FILE": "robot.yaml" if is_stdout else file.name}
    text = re.sub("SCHEMA|FILE", lambda found: values[found[0]], _STARTER.read_text("utf-8"))
    if is_stdout:
        say(text.rstrip("\n"))
        return
    try:
        with file.open("x", encoding="utf-8") as opened:
            opened.write(text)
    except FileExistsError:
        fail(f"{file} is there already; give another name")
    except OSError as error:
        fail(f"{file} cannot be written: {error.strerror}", ExitCode.NODE_FAILED)
    say(f"{file} is written; next: play-launch replay {file}")


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
    from play_launch.config.schema_export import json_schema  # noqa: PLC0415

    return json.dumps(json_schema(), indent=1, ensure_ascii=False) + "\n"
