"""What the build asks for, and what it says when the machine lacks something."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
NATIVE = ROOT / "container_native"
BACKEND = NATIVE / "packaging" / "play_launch_build.py"


@pytest.fixture(scope="module")
def backend() -> ModuleType:
    spec = importlib.util.spec_from_file_location("play_launch_build", BACKEND)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("ros", ["jazzy", "kilted"])
def test_the_wheels_are_pinned_once(backend: ModuleType, ros: str) -> None:
    wheels = backend.ros_wheels(NATIVE / "pyproject.toml", ros)
    assert any(wheel.startswith(f"ros-{ros}-rclpy==") for wheel in wheels)
    names = [wheel.split("=")[0].split(">")[0].split("<")[0] for wheel in wheels]
    pinned = [wheel for wheel in wheels if wheel.startswith("ros-")]
    assert all("==" in wheel for wheel in pinned)
    assert len([name for name in names if name.startswith("ros-")]) == len(set(pinned))


def test_no_wheel_is_asked_for_where_ros_is_sourced(
    backend: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(NATIVE)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert any(name.startswith("ros-") for name in backend.get_requires_for_build_wheel())
    (tmp_path / "share" / "rcl").mkdir(parents=True)
    required = backend.get_requires_for_build_wheel()
    assert not any(name.startswith("ros-") for name in required)
    # What ROS's generators import, which build isolation hides where the system has it.
    assert {"catkin-pkg", "empy", "lark-parser", "numpy", "setuptools"} <= {
        re.split("[=<>]", name)[0] for name in required
    }


def test_another_ros_is_refused_with_those_that_there_are(
    backend: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(NATIVE)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    required = backend.get_requires_for_build_wheel({"ros": "kilted"})
    assert "ros-kilted-rmw-fastrtps-cpp==9.3.3" in required
    with pytest.raises(SystemExit, match=r"no wheels of ROS humble.* one of jazzy, kilted"):
        backend.get_requires_for_build_wheel({"ros": "humble"})


def test_a_missing_compiler_is_one_sentence(
    backend: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(NATIVE)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(SystemExit) as stop:
        backend.build_wheel(str(tmp_path))
    message = str(stop.value).strip()
    assert "needs a C++20 compiler" in message
    assert "apt install g++" in message
    assert "\n" not in message


def test_python_headers_are_needed_for_the_interfaces_only(
    backend: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(NATIVE)
    monkeypatch.setattr(sysconfig, "get_path", lambda _: str(tmp_path))
    assert backend.missing_tools() is None
    with pytest.raises(SystemExit) as stop:
        backend.get_requires_for_build_wheel({"cmake.define.PLAY_LAUNCH_FIXTURES": "on"})
    message = str(stop.value).strip()
    assert str(tmp_path / "Python.h") in message
    assert "\n" not in message


def test_a_missing_ros_is_one_sentence(
    backend: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with pytest.raises(SystemExit) as stop:
        backend.build_wheel(str(tmp_path))
    message = str(stop.value).strip()
    assert "no ROS 2" in message
    assert "\n" not in message


ASKS_FOR_AMENT = """
cmake_minimum_required(VERSION 3.22)
project(stand_in NONE)
execute_process(
  COMMAND "${Python_EXECUTABLE}" -c "import ament_package; print(ament_package.WHOSE)"
  OUTPUT_FILE "${CMAKE_CURRENT_SOURCE_DIR}/answer"
  COMMAND_ERROR_IS_FATAL ANY)
"""
STAND_IN_PROJECT = """
[build-system]
requires = ["scikit-build-core"]
build-backend = "play_launch_build"
[project]
name = "stand-in"
version = "1"
[tool.scikit-build]
wheel.packages = []
"""


@pytest.mark.parametrize("place", ["lib/{}/site-packages", "local/lib/{}/dist-packages"])
def test_cmake_finds_the_python_packages_of_a_sourced_ros_that_pip_hides(
    tmp_path: Path, place: str
) -> None:
    """What the build runs with when pip isolates it: PYTHONPATH has pip's own folders only."""
    project, ros, pips = (tmp_path / name for name in ("project", "ros", "pips"))
    for folder in (project, pips, ros / "share" / "rcl"):
        folder.mkdir(parents=True)
    (project / "CMakeLists.txt").write_text(ASKS_FOR_AMENT)
    (project / "pyproject.toml").write_text(STAND_IN_PROJECT)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    package = ros / place.format(version) / "ament_package"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("WHOSE = 'the sourced one'\n")
    tools = Path(sys.executable).parent
    environment = {
        **os.environ,
        "AMENT_PREFIX_PATH": os.pathsep.join([str(tmp_path / "overlay"), str(ros)]),
        "PATH": os.pathsep.join([str(tools), os.environ["PATH"]]),
        "PYTHONPATH": str(pips),
    }
    call = (
        "import sys; sys.path.insert(0, sys.argv[2]); import play_launch_build as backend; "
        "backend.build_wheel(sys.argv[1])"
    )
    result = subprocess.run(
        [sys.executable, "-c", call, tmp_path, BACKEND.parent],
        check=False,
        capture_output=True,
        text=True,
        cwd=project,
        env=environment,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert (project / "answer").read_text() == "the sourced one\n"


def test_a_sourced_prefix_comes_behind_what_is_in_pythonpath(
    backend: ModuleType, tmp_path: Path
) -> None:
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    folder = tmp_path / "lib" / version / "site-packages"
    folder.mkdir(parents=True)
    environment = {"AMENT_PREFIX_PATH": f"/missing::{tmp_path}", "PYTHONPATH": "/pips"}
    path = f"/pips:{folder}"
    assert backend.sourced_python_path(environment) == path
    assert backend.sourced_python_path({**environment, "PYTHONPATH": path}) == path
    assert not backend.sourced_python_path({})


ASKS_FOR_INTERFACES = """
include("{cmake}/RosPackages.cmake")
include("{cmake}/CompositionInterfaces.cmake")
ros_has_composition_interfaces(found)
message("found: ${{found}}")
"""


@pytest.mark.parametrize("whose", ["ours", "ros", "none"])
def test_composition_interfaces_that_we_installed_ourselves_do_not_count(
    tmp_path: Path, whose: str
) -> None:
    """The next installation removes them."""
    manifest = (NATIVE / "composition_interfaces" / "package.xml").read_text()
    if whose == "ros":
        manifest = manifest.replace("<built_by>play_launch_container</built_by>", "")
    folder = tmp_path / "share" / "composition_interfaces"
    folder.mkdir(parents=True)
    if whose != "none":
        (folder / "package.xml").write_text(manifest)
    script = tmp_path / "ask.cmake"
    script.write_text(ASKS_FOR_INTERFACES.format(cmake=NATIVE / "cmake"))
    result = subprocess.run(
        [Path(sys.executable).parent / "cmake", f"-DROS_PREFIX={tmp_path}", "-P", script],
        check=True,
        capture_output=True,
        text=True,
        env={name: value for name, value in os.environ.items() if name != "AMENT_PREFIX_PATH"},
    )
    assert result.stderr.strip() == f"found: {'ON' if whose == 'ros' else 'OFF'}"


def test_cmake_says_in_one_sentence_that_ros_is_missing(tmp_path: Path) -> None:
    cmake = Path(sys.executable).parent / "cmake"
    result = subprocess.run(
        [
            cmake,
            "-G",
            "Ninja",
            f"-DCMAKE_MAKE_PROGRAM={cmake.parent / 'ninja'}",
            "-DCMAKE_DISABLE_FIND_PACKAGE_ament_cmake=ON",
            "-B",
            tmp_path,
            "-S",
            NATIVE,
        ],
        check=False,
        capture_output=True,
        text=True,
    )
    assert result.returncode != 0
    assert "no ROS 2 Jazzy found" in result.stderr
    assert result.stderr.count("CMake Error") == 1
