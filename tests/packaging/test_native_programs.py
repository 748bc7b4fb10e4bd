"""The C++ tests: built against the installed SDK, warnings as errors, and run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from play_launch.container.environment import child_environment, find_allocator
from play_launch.container.ros import ros_installation
from play_launch.ros.fastdds.shared_memory import sweep
from tests.guest.test_guest import LIMIT, in_a_virtual_machine

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


def build(folder: Path, *options: str) -> Path:
    """Build the C++ tests; gives the folder."""
    run(
        TOOLS / "cmake",
        "-G",
        "Ninja",
        f"-DCMAKE_MAKE_PROGRAM={TOOLS / 'ninja'}",
        "-DPLAY_LAUNCH_WARNINGS_ARE_ERRORS=ON",
        *options,
        "-B",
        folder,
        "-S",
        ROOT / "container_native" / "tests",
    )
    run(TOOLS / "cmake", "--build", folder)
    return folder


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(
        tmp_path_factory.mktemp("native_tests"),
        f"-DCMAKE_PREFIX_PATH={sys.prefix}",
        f"-DPLAY_LAUNCH_ALLOCATOR={find_allocator().library or ''}",
    )


@pytest.fixture(scope="module")
def built_for_arm64(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What needs no ROS, by a cross compiler."""
    if shutil.which("aarch64-linux-gnu-g++") is None:
        pytest.skip("aarch64-linux-gnu-g++ is not installed")
    return build(
        tmp_path_factory.mktemp("arm64"),
        "-DWITH_ROS=OFF",
        "-DCMAKE_SYSTEM_NAME=Linux",
        "-DCMAKE_SYSTEM_PROCESSOR=aarch64",
        "-DCMAKE_C_COMPILER=aarch64-linux-gnu-gcc",
        "-DCMAKE_CXX_COMPILER=aarch64-linux-gnu-g++",
        # Signed return addresses, as distributions have them: without effect on older processors.
        "-DCMAKE_CXX_FLAGS=-mbranch-protection=standard",
    )


def test_the_cpp_tests_build_without_warnings_and_pass(built: Path) -> None:
    try:
        output = run(TOOLS / "ctest", "--test-dir", built, "--output-on-failure", "--parallel", "2")
    finally:
        sweep()  # some of the programs abort on purpose, amidst the middleware
    assert "100% tests passed" in output
    assert "No tests were found" not in output


@pytest.mark.timeout(LIMIT)
@pytest.mark.parametrize(
    "arguments",
    # Where a core dump ends every process that shares the memory: Linux before 5.16.
    [("--older",), (str(ROOT / "tests/guest/older/isolation"),)],
    ids=["5.10", "6.1"],
)
def test_isolation_on_another_kernel(
    arguments: tuple[str, ...],
    built: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("NATIVE_TESTS", str(built))
    in_a_virtual_machine(capsys, *arguments)


@pytest.mark.timeout(LIMIT)
@pytest.mark.parametrize("options", [("--older",), ()], ids=["5.10", "6.1"])
def test_isolation_on_arm64(
    built_for_arm64: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...]
) -> None:
    in_a_virtual_machine(capsys, "--arm64", *options, str(built_for_arm64 / "isolation"))
