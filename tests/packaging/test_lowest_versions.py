"""The lowest version of each dependency that is permitted; anyio's brings sniffio with it."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]


def lowest() -> list[str]:
    """Pin each dependency to the bound that its requirement begins with."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        declared = [Requirement(text) for text in tomllib.load(file)["project"]["dependencies"]]
    bounds = {
        each.name: next(bound.version for bound in each.specifier if bound.operator == ">=")
        for each in declared
    }
    return [f"{name}=={bound}" for name, bound in bounds.items()]


def test_members_and_the_control_socket_work_with_the_lowest_versions(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "install", "-q", "--target", str(tmp_path), *lowest()]
    installed = subprocess.run(pip, check=False, capture_output=True, text=True)
    assert installed.returncode == 0, installed.stderr
    assert (tmp_path / "sniffio").is_dir()
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")
    }
    tests = ["tests/runtime", "tests/control/test_server.py"]
    pytest = Path(sys.executable).parent / "pytest"  # with -m, the checkout would come first
    ran = subprocess.run(
        [pytest, "-q", "-p", "no:cacheprovider", *tests],
        check=False,
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**environment, "PYTHONPATH": str(tmp_path)},
    )
    assert ran.returncode == 0, ran.stdout[-8000:] + ran.stderr[-2000:]
