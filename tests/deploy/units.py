"""Units as tests read them."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.deploy.test_quoting import read

ANALYZE = shutil.which("systemd-analyze")


def settings_of(text: str) -> dict[str, list[str]]:
    """The values of each setting, as `Section.Name`; nothing else may be in a unit."""
    found: dict[str, list[str]] = {}
    section = ""
    for line in text.splitlines():
        if not line or line.startswith("#"):
            continue
        if heading := re.fullmatch(r"\[(\w+)\]", line):
            section = heading[1]
            continue
        name, is_one, value = line.partition("=")
        assert is_one, line
        assert name.isalpha(), line
        assert section, line
        found.setdefault(f"{section}.{name}", []).append(value)
    return found


def words(line: str, **variables: str) -> list[str]:
    """The words of a command line, as systemd reads them."""
    found = re.findall(r'"(?:[^"\\]|\\.)*"|\S+', line)
    given = {f"${name}": value for name, value in variables.items()}
    return [given[word] if word in given else read(word, of_a_command=True) for word in found]


def verify(text: str, folder: Path, *, for_user: bool = False) -> None:
    """Have systemd read it; skips where systemd is not installed."""
    if ANALYZE is None:
        pytest.skip("systemd-analyze (Debian's package systemd) is not installed")
    unit = folder / "robot.service"
    unit.write_text(text, encoding="utf-8")
    command = [ANALYZE, "--user" if for_user else "--system", "--man=no", "verify", unit]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    # What it says about other units of the machine is not ours.
    about = [line for line in done.stderr.splitlines() if "robot.service" in line]
    assert not about, "\n".join(about)
    assert done.returncode == 0 or str(unit) not in done.stderr, done.stderr
