"""A user's component, built outside the tree with the five lines of CMake of the guide."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from std_msgs.msg import Float64

from tests.support.container import running_container
from tests.support.ros import Probe

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "docs" / "examples" / "my_robot"
GUIDE = ROOT / "docs" / "components.md"


def build(source: Path, tmp_path: Path) -> Path:
    tools = Path(sys.executable).parent
    install = tmp_path / "install"
    for command in (
        [
            tools / "cmake",
            "-G",
            "Ninja",
            f"-DCMAKE_MAKE_PROGRAM={tools / 'ninja'}",
            f"-DCMAKE_PREFIX_PATH={sys.prefix}",
            f"-DCMAKE_INSTALL_PREFIX={install}",
            "-B",
            tmp_path / "build",
            "-S",
            source,
        ],
        [tools / "cmake", "--build", tmp_path / "build"],
        [tools / "cmake", "--install", tmp_path / "build"],
    ):
        result = subprocess.run(
            [str(part) for part in command], check=False, capture_output=True, text=True
        )
        assert result.returncode == 0, result.stdout + result.stderr
    return install


def test_the_guide_shows_the_example_as_it_is() -> None:
    cmake = (EXAMPLE / "CMakeLists.txt").read_text().strip()
    blocks = re.findall(r"```cmake\n(.*?)```", GUIDE.read_text(), flags=re.DOTALL)
    assert [block.strip() for block in blocks] == [cmake]
    assert len([line for line in cmake.splitlines() if line.strip()]) == 5


TWO_LIBRARIES = """
cmake_minimum_required(VERSION 3.22)
project(two_libraries LANGUAGES CXX)
find_package(play_launch_container REQUIRED)
play_launch_add_components(first_components node.cpp PLUGINS two::A two::B)
add_subdirectory(more)
"""
ONE_MORE = "play_launch_add_components(second_components ../node.cpp PLUGINS two::C)\n"


def test_the_libraries_of_a_package_add_up_in_the_index(tmp_path: Path) -> None:
    source = tmp_path / "two_libraries"
    (source / "more").mkdir(parents=True)
    (source / "CMakeLists.txt").write_text(TWO_LIBRARIES)
    (source / "more" / "CMakeLists.txt").write_text(ONE_MORE)
    (source / "node.cpp").touch()
    for _ in range(2):  # configured again, nothing is there twice
        install = build(source, tmp_path)
        index = install / "share" / "ament_index" / "resource_index"
        assert (index / "play_launch_components" / "two_libraries").read_text().splitlines() == [
            "two::A;lib/libfirst_components.so",
            "two::B;lib/libfirst_components.so",
            "two::C;lib/libsecond_components.so",
        ]
        assert (index / "packages" / "two_libraries").is_file()


def test_a_component_built_outside_the_tree_runs(tmp_path: Path) -> None:
    source = tmp_path / "my_robot"
    shutil.copytree(EXAMPLE, source)
    install = build(source, tmp_path)
    log = tmp_path / "container.log"
    environment = {
        "AMENT_PREFIX_PATH": os.pathsep.join(
            [str(install), *filter(None, [os.environ.get("AMENT_PREFIX_PATH")])]
        )
    }
    with (
        running_container(name="power", log=log, environment=environment),
        Probe() as probe,
    ):
        answer = probe.load("Battery", package="my_robot", container="/power")
        assert answer.success, answer.error_message + log.read_text()
        assert probe.collect(Float64, "/voltage")[0].data == 24.0
