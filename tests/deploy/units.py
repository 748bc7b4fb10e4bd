"""Units as tests read them."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ANALYZE = shutil.which("systemd-analyze")
_ESCAPES = {"\\\\": "\\", '\\"': '"', "\\n": "\n", "\\t": "\t"}


def read(word: str, *, of_a_command: bool = False) -> str:
    """As systemd does: quotes, then specifiers, then variables."""
    if word.startswith('"'):
        assert word.endswith('"')
        assert len(word) > 1
        inner = word[1:-1]
        assert re.fullmatch(r'([^"\\\n]|\\[\\"nt])*', inner), inner
        word = re.sub(r"\\.", lambda match: _ESCAPES[match[0]], inner)
    else:
        assert re.fullmatch(r"[^\s\"'\\]+", word), word
    assert re.fullmatch(r"([^%]|%%)*", word), word
    word = word.replace("%%", "%")
    if of_a_command:
        assert re.fullmatch(r"([^$]|\$\$)*", word), word
        word = word.replace("$$", "$")
    return word


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
