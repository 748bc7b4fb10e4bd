"""Writes units as a configuration and reads it again."""

from __future__ import annotations

from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from play_launch.config.load import load_config
from play_launch.config.model import ReplayConfig
from play_launch.container.parameter_files import parameter_file_text
from play_launch.launch_files.configuration.request import Options
from play_launch.launch_files.configuration.write import Written, written
from play_launch.launch_files.parameters import take_sections
from play_launch.launch_files.records import (
    Description,
    LaunchedProcess,
    ParameterFile,
    Unit,
)
from play_launch.launch_files.ros_launch.rcl_parameters import RclParameters


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


def evaluated(unit: LaunchedProcess) -> LaunchedProcess:
    """Give a node what rcl gives it of its sources."""
    reader = RclParameters()
    for source in unit.sources:
        with NamedTemporaryFile("w") as file:
            if isinstance(source, ParameterFile):
                file.write(Path(source.path).read_text() if source.text is None else source.text)
            else:
                file.write(parameter_file_text([(source.pattern, source.parameters)]))
            file.flush()
            reader.add_file(file.name)
    take_sections(unit, reader.sections())
    reader.close()
    return unit
