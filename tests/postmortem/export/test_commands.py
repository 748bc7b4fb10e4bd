"""The verbs on real files, as `docs/viewing.md` shows them."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from tests.postmortem.export.test_layouts import STORY
from tests.postmortem.export.trace_format import read_trace
from tests.postmortem.test_past_session import record
from tests.support.replay import COMMAND

PAGE = (Path(__file__).parents[3] / "docs" / "viewing.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\$ (play-launch .*)$", PAGE, re.MULTILINE)
PROGRAM = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def run(*arguments: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [COMMAND, *arguments], cwd=folder, check=False, capture_output=True, text=True
    )


def test_the_commands_and_the_program_of_the_page(tmp_path: Path) -> None:
    record(tmp_path / "session.mcap", STORY)
    assert len(COMMANDS) == 4
    for command in COMMANDS:
        subprocess.run(
            command,
            shell=True,
            cwd=tmp_path,
            check=True,
            env={**os.environ, "PATH": f"{COMMAND.parent}:{os.environ['PATH']}"},
            stdout=subprocess.PIPE,
        )
    assert "configById" in json.loads((tmp_path / "session.layout.json").read_text())
    assert ET.fromstring((tmp_path / "session.layout.xml").read_bytes()).tag == "root"
    assert read_trace(tmp_path / "session.trace.json")
    (program,) = PROGRAM
    printed = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, check=True, capture_output=True, text=True
    ).stdout
    assert printed.startswith("/box 0.0 % at ")


def test_a_damaged_recording_is_exported_as_far_as_it_can_be_read(tmp_path: Path) -> None:
    path = record(tmp_path / "session.mcap", STORY)
    path.write_bytes(path.read_bytes()[:-30])
    for arguments in (
        ("export", path),
        ("export", path, "--format", "csv"),
        ("layout", "foxglove", path),
    ):
        result = run(*arguments, folder=tmp_path)
        assert result.returncode == 5
        assert "warning: " in result.stderr
        assert "Traceback" not in result.stderr
    assert any(event["ph"] == "X" for event in read_trace(tmp_path / "session.trace.json"))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("export", "text.mcap"), 2, "text.mcap: it is not an MCAP file"),
        (("export", "missing.mcap"), 2, "missing.mcap: No such file or directory"),
        (
            ("export", "session.mcap", "--format", "xml"),
            2,
            "not one of 'perfetto', 'csv', 'parquet'",
        ),
        (("export", "session.mcap", "-o", "no/x.json"), 1, "no/x.json: No such file or directory"),
        (
            ("export", "session.mcap", "--format", "csv", "-o", "text.mcap"),
            1,
            "text.mcap: File exists",
        ),
        (("layout", "rviz"), 2, "not one of 'foxglove', 'plotjuggler'"),
        (("layout", "foxglove", "text.mcap"), 2, "it is not an MCAP file"),
    ],
)
def test_mistakes_are_named(
    tmp_path: Path, arguments: tuple[str, ...], code: int, message: str
) -> None:
    record(tmp_path / "session.mcap", STORY)
    (tmp_path / "text.mcap").write_text("hello", encoding="utf-8")
    result = run(*arguments, folder=tmp_path)
    assert result.returncode == code
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "text.trace.json").exists()
