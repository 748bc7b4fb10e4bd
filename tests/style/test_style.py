"""The checks of style and types, as tests, so that one command runs them all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LINES_PER_FILE = 450


def tracked(*patterns: str) -> list[str]:
    listing = subprocess.run(
        ["git", "ls-files", "-z", "--", *patterns],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    return [name for name in listing.stdout.split("\0") if name and (ROOT / name).is_file()]


def run(*command: str) -> None:
    result = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert result.returncode == 0, f"{' '.join(command[:4])} …\n{result.stdout}{result.stderr}"


def test_ruff_finds_nothing() -> None:
    run(sys.executable, "-m", "ruff", "check", ".")


def test_python_is_formatted() -> None:
    run(sys.executable, "-m", "ruff", "format", "--check", ".")


def test_types_hold_under_mypy_strict() -> None:
    run(sys.executable, "-m", "mypy")


def test_cpp_is_formatted() -> None:
    sources = tracked("*.cpp", "*.hpp", "*.c")
    assert sources
    program = Path(sys.executable).parent / "clang-format"
    run(str(program), "--dry-run", "--Werror", *sources)


@pytest.mark.parametrize("name", tracked("*.py", "*.cpp", "*.hpp", "*.cmake", "CMakeLists.txt"))
def test_a_file_holds_one_subject(name: str) -> None:
    lines = len((ROOT / name).read_text(encoding="utf-8").splitlines())
    assert lines <= LINES_PER_FILE, f"{name} has {lines} lines: split it by subject"
