"""A middleware that cannot be had is refused; one that can is not."""

from __future__ import annotations

from pathlib import Path

import pytest

from play_launch.container.ros import RosInstallation, RosSource, middleware_problem

CYCLONE = "rmw_cyclonedds_cpp"
LIBRARY = f"lib{CYCLONE}.so"


def library_in(prefix: Path, name: str = LIBRARY) -> Path:
    path = prefix / "lib" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


def problem(source: RosSource, prefix: Path, **environ: str) -> str | None:
    return middleware_problem(RosInstallation(source, prefix, (prefix / "lib",)), environ)


@pytest.mark.parametrize("source", RosSource)
def test_who_asks_for_none_gets_what_is_there(source: RosSource, tmp_path: Path) -> None:
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


@pytest.mark.parametrize("preloaded", [LIBRARY, f"/x/{LIBRARY}", f"libx.so:/x/{LIBRARY} liby.so"])
def test_what_is_preloaded_works_with_the_wheels(preloaded: str, tmp_path: Path) -> None:
    wheels = RosSource.WHEELS
    environ = {"RMW_IMPLEMENTATION": CYCLONE, "LD_PRELOAD": preloaded}
    assert problem(wheels, tmp_path, **environ) is None
    assert problem(wheels, tmp_path, RMW_IMPLEMENTATION=CYCLONE, LD_PRELOAD="libx.so") is not None


def test_an_installation_switches_to_what_is_installed(tmp_path: Path) -> None:
    system, prefix = RosSource.SYSTEM, tmp_path / "jazzy"
    environ = {"RMW_IMPLEMENTATION": CYCLONE, "AMENT_PREFIX_PATH": str(prefix)}
    refused = problem(system, tmp_path, ROS_DISTRO="kilted", **environ)
    assert refused is not None
    assert f"{LIBRARY} is neither in" in refused
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
