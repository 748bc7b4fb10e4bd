"""Imports between the packages of play_launch point downwards only."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "play_launch"

# From the bottom up. A package may import those of lower layers, never its neighbours.
LAYERS = (
    {"cdr", "config"},
    {"supervisor"},
    {"cgroups", "fastdds"},
    {"wire", "install", "process", "recording", "ros", "sampling"},
    {"runtime", "graph_daemon", "history", "ros2cli_patch", "topic_recording"},
    {"control", "launch_files"},
    {"reporting", "doctor", "archive", "exporting", "importing", "systemd"},
    {"cli"},
)
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}


def imported(path: Path) -> set[str]:
    """Return the packages of play_launch that a module imports, also inside functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        modules: list[str] = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; write play_launch.… instead"
            modules = [node.module or ""]
            modules += [f"{node.module}.{alias.name}" for alias in node.names]
        for module in modules:
            parts = module.split(".")
            if parts[0] == "play_launch" and len(parts) > 1:
                names.add(parts[1])
    return names & LEVEL.keys()


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downwards(path: Path) -> None:
    package = path.relative_to(PACKAGE).parts[0]
    if package not in LEVEL:
        assert path.parent == PACKAGE, f"{path}: unknown package, give it a layer"
        assert not imported(path), f"{path}: the root package imports nothing"
        return
    for other in imported(path) - {package}:
        assert LEVEL[other] < LEVEL[package], f"{path}: {package} may not import {other}"


# What the rooms of the graph daemon may import of one another.
DAEMON_ROOMS: dict[str, set[str]] = {"server": set(), "client": set(), "control": {"client"}}


@pytest.mark.parametrize("room", DAEMON_ROOMS)
def test_rooms_of_the_graph_daemon_are_apart(room: str) -> None:
    # The client must come up at once, and the daemon's process holds no more than it needs.
    paths = sorted((PACKAGE / "graph_daemon" / room).rglob("*.py"))
    assert len(paths) > 1
    for path in paths:
        text = path.read_text(encoding="utf-8")
        others = DAEMON_ROOMS.keys() - DAEMON_ROOMS[room] - {room}
        wrong = [other for other in others if f"play_launch.graph_daemon.{other}" in text]
        assert not wrong, f"{path}: {room} may not import {wrong}"


def test_every_package_has_a_layer() -> None:
    packages = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file()}
    assert packages <= LEVEL.keys()
    assert {"supervisor", "config", "cli"} <= packages
