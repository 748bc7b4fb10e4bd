"""Includes between the rooms of the container's C++ sources point downwards only."""

from __future__ import annotations

import re
from pathlib import Path

NATIVE = Path(__file__).resolve().parents[2] / "container_native"
SOURCES = NATIVE / "src"

# From the bottom up. A room may include what lies in lower layers, never its neighbours'. The
# headers of the SDK are <play_launch/…>, which every room but the lowest may use.
LAYERS = (
    {"base"},
    {"sdk", "control", "fastdds", "isolation/record"},
    {"isolation/after", "isolation/memory"},
    {"isolation/quiesce"},
    {"isolation/crash"},
    {"isolation/clone"},
    {"overrides"},
    {"components"},
    {"components/rclcpp", "hosts"},
    {"hosts/isolated", "hosts/shared"},
    {"hosts/cloned", "hosts/spawned"},
    {"manager"},
    {"main"},
)
LEVEL = {room: level for level, rooms in enumerate(LAYERS) for room in rooms}
# Programs of their own, which use nothing but these.
APART = {"spawn_guard", "topic_recorder"}
SHARED = {"base", "fastdds"}

INCLUDE = re.compile(r'^#include "([^"]+)"', re.MULTILINE)


def sources() -> list[Path]:
    return sorted(path for path in SOURCES.rglob("*") if path.suffix in {".cpp", ".hpp", ".c"})


def room_of(path: Path) -> str:
    return path.relative_to(SOURCES).parent.as_posix()


def included_files(path: Path) -> list[Path]:
    names = INCLUDE.findall(path.read_text(encoding="utf-8"))
    beside = [path.parent / name for name in names]
    files = [
        near if near.is_file() else SOURCES / name for near, name in zip(beside, names, strict=True)
    ]
    missing = [str(file) for file in files if not file.is_file()]
    assert not missing, f"{path}: written with quotes, but not below src/: {missing}"
    return files


def refused(path: Path) -> set[str]:
    """Return the rooms that a file may not include from."""
    room = room_of(path)
    others = {room_of(file) for file in included_files(path)} - {room}
    if room in APART:
        return others - SHARED
    return {other for other in others if LEVEL[other] >= LEVEL[room]}


def test_includes_point_downwards() -> None:
    assert {room_of(path) for path in sources()} == LEVEL.keys() | APART
    wrong = {
        str(path.relative_to(SOURCES)): found for path in sources() if (found := refused(path))
    }
    assert not wrong
