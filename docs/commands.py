"""Adds the help of all commands to the site, as a page."""

from typing import Any

from mkdocs.structure.files import File, Files

from play_launch.cli.manual import manual_as


def on_files(files: Files, config: Any) -> Files:
    files.append(File.generated(config, "commands.md", content=manual_as("markdown")))
    return files
