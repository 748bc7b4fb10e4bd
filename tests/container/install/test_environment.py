"""What processes get: allocator, preloaded libraries, environment, middleware."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from play_launch.container.environment import (
    BOOTSTRAP_MARK,
    Allocator,
    allocating_with,
    child_environment,
    find_allocator,
    for_isolation,
    foreign_python_environment,
    preloaded_in,
    preloading,
    with_safe_waits,
)
from play_launch.container.ros import (
    RosInstallation,
    RosSource,
    component_container,
    middleware_problem,
    ros_installation,
)

VENV = Path("/venv")
WHEELS = RosInstallation(RosSource.WHEELS, VENV, (VENV / "lib", VENV / "site" / "ros_a.libs"))
SYSTEM = RosInstallation(RosSource.SYSTEM, VENV, (VENV / "lib",))


def test_wheels_are_complete() -> None:
    made = child_environment({"PATH": "/bin", "HOME": "/home"}, WHEELS)
    assert made["LD_LIBRARY_PATH"] == "/venv/lib:/venv/site/ros_a.libs"
    assert made["AMENT_PREFIX_PATH"] == "/venv"
    assert made["PATH"] == "/venv/bin:/bin"
    assert made[BOOTSTRAP_MARK] == "1"
    assert made["HOME"] == "/home"


def test_a_sourced_ros_gets_our_prefix_added_only() -> None:
    base = {
        "PATH": "/opt/ros/jazzy/bin:/bin",
        "LD_LIBRARY_PATH": "/opt/ros/jazzy/lib",
        "AMENT_PREFIX_PATH": "/ws:/opt/ros/jazzy",
    }
    made = child_environment(base, SYSTEM)
    assert made["PATH"] == base["PATH"]
    assert made["LD_LIBRARY_PATH"] == "/venv/lib:/opt/ros/jazzy/lib"
    assert made["AMENT_PREFIX_PATH"] == "/venv:/ws:/opt/ros/jazzy"
    assert BOOTSTRAP_MARK not in made


def test_doing_it_again_changes_nothing() -> None:
    base = {"PATH": "/bin:/venv/bin", "LD_LIBRARY_PATH": "/x:/venv/lib::", "AMENT_PREFIX_PATH": ""}
    for ros in (WHEELS, SYSTEM):
        once = child_environment(base, ros)
        assert child_environment(once, ros) == once
        assert once["PATH"] == base["PATH"]
        assert once["LD_LIBRARY_PATH"].endswith("/x")


def test_what_was_set_wins_over_defaults_and_what_was_declared_over_all() -> None:
    made = child_environment({}, WHEELS)
    assert made["PYTHONUNBUFFERED"] == "1"
    assert made["RCUTILS_COLORIZED_OUTPUT"] == "0"
    made = child_environment({"RCUTILS_COLORIZED_OUTPUT": "1"}, WHEELS, {"LD_LIBRARY_PATH": "/x"})
    assert made["RCUTILS_COLORIZED_OUTPUT"] == "1"
    assert made["LD_LIBRARY_PATH"] == "/x"


def test_a_python_of_another_environment_finds_its_own_ros() -> None:
    made = child_environment({"LD_LIBRARY_PATH": "/mine", "PATH": "/bin"}, WHEELS)
    changed = foreign_python_environment(made, WHEELS, Path("/other/bin/python3.12"))
    assert BOOTSTRAP_MARK not in changed
    assert changed["LD_LIBRARY_PATH"] == "/mine"
    assert "AMENT_PREFIX_PATH" not in changed
    for program in ("/venv/bin/python3", "/bin/sleep", "/usr/bin/python3-config"):
        assert foreign_python_environment(made, WHEELS, Path(program)) == made
    made = child_environment({}, SYSTEM)
    assert foreign_python_environment(made, SYSTEM, Path("/usr/bin/python3")) == made


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
    monkeypatch.setattr(sys, "path", ["", *map(str, packages)])
    return find_allocator({})


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


def test_variable_then_package_then_mimalloc_then_jemalloc(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    wheel = library(tmp_path / "cmeel.prefix/lib/libmimalloc.so.3")
    own = library(tmp_path / "own.so")
    both = {"mimalloc": "libmimalloc.so.2", "jemalloc": "libjemalloc.so.2"}
    variable = {"PLAY_LAUNCH_ALLOCATOR": str(own)}
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert find_allocator(variable) == Allocator(own)
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


CONTAINER = Path("/p/component_container")
LIBRARY = "/p/libfastdds_waits.so"
ASAN = "verify_asan_link_order=0"
LOCKING_TWICE = """
import ctypes
c = ctypes.CDLL(None)
mutex, attributes, passed = (ctypes.create_string_buffer(64) for _ in range(3))
c.pthread_mutexattr_init(attributes)
c.pthread_mutexattr_setpshared(attributes, 1)
c.pthread_mutex_init(mutex, attributes)
print(c.pthread_mutex_timedlock(mutex, passed), c.pthread_mutex_timedlock(mutex, passed))
"""


@pytest.mark.parametrize(
    ("before", "last", "after"),
    [
        ({}, False, ["/l/liba.so"]),
        ({"LD_PRELOAD": "libb.so /x/libc.so"}, False, ["/l/liba.so", "libb.so", "/x/libc.so"]),
        ({"LD_PRELOAD": "libb.so:/x/libc.so"}, True, ["libb.so", "/x/libc.so", "/l/liba.so"]),
    ],
)
def test_a_library_is_added(before: dict[str, str], last: bool, after: list[str]) -> None:
    assert preloaded_in(preloading(before, Path("/l/liba.so"), last=last)) == after


def test_in_a_folder_with_a_space_it_is_searched_for() -> None:
    changed = preloading({"LD_LIBRARY_PATH": "/x"}, Path("/a b/liba.so"))
    assert changed == {"LD_PRELOAD": "liba.so", "LD_LIBRARY_PATH": "/a b:/x"}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, {"LD_PRELOAD": LIBRARY, "ASAN_OPTIONS": ASAN}),
        (
            {"LD_PRELOAD": "libasan.so.8", "ASAN_OPTIONS": "detect_leaks=0"},
            {"LD_PRELOAD": f"libasan.so.8:{LIBRARY}", "ASAN_OPTIONS": f"{ASAN}:detect_leaks=0"},
        ),
        ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, None),
        ({"PLAY_LAUNCH_FASTDDS_WAITS": "0"}, None),
    ],
    ids=["plain", "others before", "another middleware", "switched off"],
)
def test_ordinary_processes_get_it_with_fast_dds(
    before: dict[str, str], after: dict[str, str] | None
) -> None:
    assert with_safe_waits(before, CONTAINER) == (before if after is None else before | after)


@pytest.mark.parametrize("before", [{}, {"LD_PRELOAD": "libx.so", "ASAN_OPTIONS": "a=1:b=2"}])
def test_a_session_in_a_session_preloads_it_once(before: dict[str, str]) -> None:
    once = with_safe_waits(before, CONTAINER)
    assert with_safe_waits(once, CONTAINER) == once


def test_a_program_gets_its_own_mutex_again() -> None:
    environment = with_safe_waits(os.environ, component_container())
    command = [sys.executable, "-c", LOCKING_TWICE]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("0 0\n", "")


def test_a_program_with_a_sanitizer_starts(tmp_path: Path) -> None:
    source, program = tmp_path / "leaks_not.c", tmp_path / "leaks_not"
    source.write_text('#include <stdio.h>\nint main(void) { return puts("started") < 0; }\n')
    compiler = os.environ.get("CC", "cc")
    built = subprocess.run(
        [compiler, "-fsanitize=address", "-o", program, source], check=False, capture_output=True
    )
    if built.returncode != 0:
        pytest.skip(f"{shutil.which(compiler) or compiler} has no AddressSanitizer")
    environment = with_safe_waits(os.environ, component_container())
    done = subprocess.run([program], env=environment, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "started\n"), done.stderr


CYCLONE = "rmw_cyclonedds_cpp"
RMW_LIBRARY = f"lib{CYCLONE}.so"


def library_in(prefix: Path, name: str = RMW_LIBRARY) -> Path:
    path = prefix / "lib" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


def problem(source: RosSource, prefix: Path, **environ: str) -> str | None:
    return middleware_problem(RosInstallation(source, prefix, (prefix / "lib",)), environ)


@pytest.mark.parametrize("source", RosSource)
def test_without_a_choice_the_installed_one_is_used(source: RosSource, tmp_path: Path) -> None:
    assert problem(source, tmp_path) is None
    assert problem(source, tmp_path, RMW_IMPLEMENTATION="") is None


def test_the_wheels_are_linked_to_fast_dds(tmp_path: Path) -> None:
    wheels = RosSource.WHEELS
    assert problem(wheels, tmp_path, RMW_IMPLEMENTATION="rmw_fastrtps_cpp") is None
    refused = problem(wheels, tmp_path, RMW_IMPLEMENTATION=CYCLONE)
    assert refused is not None
    assert f"RMW_IMPLEMENTATION is {CYCLONE}, but" in refused
    assert "source a ROS installation" in refused


def test_what_is_there_for_the_wheels_is_to_be_preloaded(tmp_path: Path) -> None:
    wheels, path = RosSource.WHEELS, library_in(tmp_path / "overlay")
    overlay = str(tmp_path / "overlay")
    refused = problem(wheels, tmp_path, RMW_IMPLEMENTATION=CYCLONE, AMENT_PREFIX_PATH=overlay)
    assert refused is not None
    assert f"LD_PRELOAD={path}" in refused


@pytest.mark.parametrize(
    "preloaded", [RMW_LIBRARY, f"/x/{RMW_LIBRARY}", f"libx.so:/x/{RMW_LIBRARY} liby.so"]
)
def test_what_is_preloaded_works_with_the_wheels(preloaded: str, tmp_path: Path) -> None:
    wheels = RosSource.WHEELS
    environ = {"RMW_IMPLEMENTATION": CYCLONE, "LD_PRELOAD": preloaded.format(RMW_LIBRARY)}
    assert problem(wheels, tmp_path, **environ) is None
    assert problem(wheels, tmp_path, RMW_IMPLEMENTATION=CYCLONE, LD_PRELOAD="libx.so") is not None


def test_an_installation_switches_to_what_is_installed(tmp_path: Path) -> None:
    system, prefix = RosSource.SYSTEM, tmp_path / "jazzy"
    environ = {"RMW_IMPLEMENTATION": CYCLONE, "AMENT_PREFIX_PATH": str(prefix)}
    refused = problem(system, tmp_path, ROS_DISTRO="kilted", **environ)
    assert refused is not None
    assert f"{RMW_LIBRARY} is neither in" in refused
    assert "apt install ros-kilted-rmw-cyclonedds-cpp" in refused
    library_in(prefix)
    assert problem(system, tmp_path, **environ) is None


def test_a_library_in_the_library_path_is_found(tmp_path: Path) -> None:
    folder = str(library_in(tmp_path / "opt").parent)
    environ = {"RMW_IMPLEMENTATION": CYCLONE, "LD_LIBRARY_PATH": f"/nowhere:{folder}"}
    assert problem(RosSource.SYSTEM, tmp_path, **environ) is None


def test_wheels_with_a_switch_are_like_an_installation(tmp_path: Path) -> None:
    library_in(tmp_path, "librmw_implementation.so")
    assert problem(RosSource.WHEELS, tmp_path, RMW_IMPLEMENTATION=CYCLONE) is not None
    library_in(tmp_path)
    assert problem(RosSource.WHEELS, tmp_path, RMW_IMPLEMENTATION=CYCLONE) is None
