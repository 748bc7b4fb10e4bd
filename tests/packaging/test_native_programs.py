"""The C++ tests: built against the installed SDK, warnings as errors, and run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from play_launch.container.environment import child_environment, find_allocator
from play_launch.container.ros import ros_installation
from play_launch.ros.fastdds.shared_memory import sweep

ROOT = Path(__file__).resolve().parents[2]
TOOLS = Path(sys.executable).parent


def run(*command: object) -> str:
    result = subprocess.run(
        [str(part) for part in command],
        check=False,
        capture_output=True,
        text=True,
        env=child_environment(os.environ, ros_installation()),
    )
    output = result.stdout + result.stderr
    assert result.returncode == 0, output[-8000:]
    return output


def test_the_cpp_tests_build_without_warnings_and_pass(tmp_path: Path) -> None:
    run(
        TOOLS / "cmake",
        "-G",
        "Ninja",
        f"-DCMAKE_MAKE_PROGRAM={TOOLS / 'ninja'}",
        f"-DCMAKE_PREFIX_PATH={sys.prefix}",
        "-DPLAY_LAUNCH_WARNINGS_ARE_ERRORS=ON",
        f"-DPLAY_LAUNCH_ALLOCATOR={find_allocator().library or ''}",
        "-B",
        tmp_path,
        "-S",
        ROOT / "container_native" / "tests",
    )
    run(TOOLS / "cmake", "--build", tmp_path)
    try:
        output = run(
            TOOLS / "ctest", "--test-dir", tmp_path, "--output-on-failure", "--parallel", "2"
        )
    finally:
        sweep()  # some of the programs abort on purpose, amidst the middleware
    assert "100% tests passed" in output
    assert "No tests were found" not in output
