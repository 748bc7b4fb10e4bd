"""Writes units as a configuration and reads it again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from play_launch.config.load import load_config
from play_launch.config.model import ReplayConfig
from play_launch.launch_files.configuration.options import Options
from play_launch.launch_files.configuration.write import Written, written
from play_launch.launch_files.parameters import evaluate_sources
from play_launch.launch_files.records import (
    Description,
    LaunchedProcess,
    Losses,
    ParameterFile,
    Unit,
)


def load(made: Written, folder: Path) -> ReplayConfig:
    path = folder / "written.yaml"
    path.write_text(made.text, encoding="utf-8")
    return load_config(path)


def write(*units: Unit, folder: Path = Path("/nowhere"), **options: Any) -> Written:
    return written(Description(units=list(units)), Options(folder=folder, **options), "From x.")


def lost(made: Written) -> list[str]:
    return [f"{each.where}: {each.what}" for each in made.losses if not each.is_note]


def params(path: Path, text: str) -> ParameterFile:
    path.write_text(text, encoding="utf-8")
    return ParameterFile(str(path))


def node(**fields: Any) -> LaunchedProcess:
    return LaunchedProcess(
        **{"package": "p", "executable": "e", "name": "n", "namespace": "/a"} | fields
    )


def evaluated(unit: Unit) -> Unit:
    losses = Losses()
    evaluate_sources(unit, losses)
    assert not list(losses)
    return unit
