"""Which allocator isolated containers get."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from play_launch.container.environment import (
    Allocator,
    allocating_with,
    find_allocator,
    for_isolation,
)
from play_launch.container.ros import RosSource, ros_installation

PYTHON = Path(sys.executable).resolve()


def library(path: Path) -> Path:
    """A file that looks like a library for this machine: the beginning of a program for it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with PYTHON.open("rb") as file:
        path.write_bytes(file.read(64))
    return path


def found(
    monkeypatch: pytest.MonkeyPatch, installed: dict[str, str], packages: Sequence[Path] = ()
) -> Allocator:
    monkeypatch.setattr("ctypes.util.find_library", installed.get)
    return find_allocator({}, packages=packages)


def test_a_variable_that_names_nothing_of_use_is_told(tmp_path: Path) -> None:
    text = tmp_path / "libmimalloc.so.2"
    text.write_text("INPUT(libmimalloc.so.2.0)")
    for path in (text, tmp_path / "missing.so", tmp_path):
        answer = find_allocator({"PLAY_LAUNCH_ALLOCATOR": str(path)})
        assert answer.library is None
        assert str(path) in answer.problem


def test_the_extra_brings_the_allocator_that_is_found_by_itself() -> None:
    if ros_installation().source is not RosSource.WHEELS:
        pytest.skip("ROS is not from wheels")
    answer = find_allocator({})
    assert answer.library is not None
    assert answer.library.is_relative_to(sys.prefix)
    assert answer.library.name == "libmimalloc.so.3"


def test_a_library_in_a_folder_with_a_space_is_loaded(tmp_path: Path) -> None:
    maps = Path("/proc/self/maps").read_text()
    any_library = re.search(r"/\S*/libm\.so\.\S+", maps)
    assert any_library
    copy = tmp_path / "a folder" / "libcopy.so"
    copy.parent.mkdir()
    shutil.copy(any_library[0], copy)
    environment = allocating_with({"LD_LIBRARY_PATH": "/nowhere"}, copy)
    assert environment["LD_LIBRARY_PATH"] == f"{copy.parent}:/nowhere"
    loaded = subprocess.run(
        ["cat", "/proc/self/maps"], check=True, capture_output=True, text=True, env=environment
    )
    assert str(copy) in loaded.stdout
    assert not loaded.stderr


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, "/l/libmimalloc.so.2"),
        ({"LD_PRELOAD": "/x/liba.so libb.so"}, "/l/libmimalloc.so.2:/x/liba.so:libb.so"),
        ({"LD_PRELOAD": "/x/libjemalloc.so.2"}, "/x/libjemalloc.so.2"),
        ({"LD_PRELOAD": "/x/libmimalloc-secure.so.2.0:y"}, "/x/libmimalloc-secure.so.2.0:y"),
    ],
)
def test_preloading(before: dict[str, str], after: str) -> None:
    assert allocating_with(before, Path("/l/libmimalloc.so.2"))["LD_PRELOAD"] == after


@pytest.mark.parametrize(
    ("library", "before", "after"),
    [
        ("libmimalloc.so.3", {}, "0"),
        ("libmimalloc.so.2", {"MIMALLOC_ALLOW_THP": "1"}, "1"),
        ("libjemalloc.so.2", {}, None),
    ],
)
def test_mimalloc_does_without_huge_pages_unless_asked_for(
    library: str, before: dict[str, str], after: str | None
) -> None:
    assert allocating_with(before, Path("/l") / library).get("MIMALLOC_ALLOW_THP") == after


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, "glibc.malloc.arena_max=100000"),
        (
            {"GLIBC_TUNABLES": "glibc.malloc.check=1"},
            "glibc.malloc.check=1:glibc.malloc.arena_max=100000",
        ),
        ({"GLIBC_TUNABLES": "glibc.malloc.arena_max=2"}, "glibc.malloc.arena_max=2"),
    ],
)
def test_without_a_library_each_thread_gets_an_arena(before: dict[str, str], after: str) -> None:
    environment = for_isolation({"LD_PRELOAD": "/l/libguard.so"} | before, None)
    assert environment == {"LD_PRELOAD": "/l/libguard.so", "GLIBC_TUNABLES": after}


def test_with_a_library_the_c_librarys_allocator_is_left_alone() -> None:
    library = Path("/l/libmimalloc.so.2")
    environment = {"LD_PRELOAD": str(library), "MIMALLOC_ALLOW_THP": "0"}
    assert for_isolation({}, library) == environment


def test_variable_then_package_then_mimalloc_then_jemalloc(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    wheel = library(tmp_path / "cmeel.prefix/lib/libmimalloc.so.3")
    own = library(tmp_path / "own.so")
    both = {"mimalloc": "libmimalloc.so.2", "jemalloc": "libjemalloc.so.2"}
    variable = {"PLAY_LAUNCH_ALLOCATOR": str(own)}
    assert find_allocator(variable, packages=[tmp_path]) == Allocator(own)
    assert found(monkeypatch, both, [tmp_path]) == Allocator(wheel)
    assert found(monkeypatch, both) == Allocator(Path("libmimalloc.so.2"))
    only = {"jemalloc": "libjemalloc.so.2"}
    assert found(monkeypatch, only) == Allocator(Path("libjemalloc.so.2"))


def test_none_is_reported_with_the_impact_and_the_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = found(monkeypatch, {})
    assert answer.library is None
    assert "neither mimalloc nor jemalloc" in answer.problem
    assert "freeze" in answer.problem
    assert "pip install cmeel-mimalloc" in answer.problem
