"""An installation of made-up packages, as an ament index has it, and evaluations in it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from textwrap import dedent

import pytest

from play_launch.launch_files.records import (
    Composable,
    Description,
    LaunchedProcess,
    LaunchFileError,
)
from play_launch.launch_files.ros_launch.evaluate import evaluate
from tests.support.launch import needs_launch, use_launch

__all__ = ["needs_launch"]
LIMIT = 120.0


class Prefix:
    """A folder with packages that have executables, and the launch files of a test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.add("pkg", "talker", "listener", "component_container")

    def add(self, package: str, *executables: str) -> None:
        index = self.folder / "share" / "ament_index" / "resource_index" / "packages"
        index.mkdir(parents=True, exist_ok=True)
        (index / package).touch()
        (self.folder / "share" / package).mkdir(exist_ok=True)
        folder = self.folder / "lib" / package
        folder.mkdir(parents=True, exist_ok=True)
        for name in executables:
            (folder / name).write_text("#!/bin/sh\n")
            (folder / name).chmod(0o755)

    def file(self, name: str, text: str) -> Path:
        path = self.folder / name
        path.write_text(dedent(text).lstrip("\n"), encoding="utf-8")
        return path

    def evaluate(
        self,
        name: str,
        text: str,
        arguments: Mapping[str, str] | None = None,
        *,
        limit: float = LIMIT,
        is_faster: bool = True,
        only_arguments: bool = False,
    ) -> Description:
        return evaluate(
            self.file(name, text),
            arguments or {},
            limit=limit,
            is_faster=is_faster,
            only_arguments=only_arguments,
        )

    def error(
        self,
        name: str,
        text: str,
        arguments: Mapping[str, str] | None = None,
        *,
        limit: float = LIMIT,
    ) -> str:
        """Return the error of a launch file, with the folder left out."""
        with pytest.raises(LaunchFileError) as caught:
            self.evaluate(name, text, arguments, limit=limit)
        return str(caught.value).replace(f"{self.folder}/", "")


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Prefix]:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.delenv("ROS_LOG_DIR", raising=False)
    paths = [str(tmp_path), *filter(None, [os.environ.get("AMENT_PREFIX_PATH")])]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(paths))
    use_launch(monkeypatch)
    yield Prefix(tmp_path)
    # Launch has a folder for its logs, which an evaluation does not need.
    assert [str(path) for path in (tmp_path / "home").rglob("*")] == []


def processes(description: Description) -> list[LaunchedProcess]:
    return [unit for unit in description.units if isinstance(unit, LaunchedProcess)]


def composables(description: Description) -> list[Composable]:
    return [unit for unit in description.units if isinstance(unit, Composable)]
