"""`docs/tutorial.md`, typed as it stands."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tests.support.replay import alive, run
from tests.support.waiting import LIMIT, until

PAGE = Path(__file__).resolve().parents[2] / "docs" / "tutorial.md"
_PART = re.compile(
    r"(?:<!-- (?P<note>[^\n]*) -->\n)(?!```)"  # a remark that is an event of its own
    r"|(?:<!-- (?P<about>[^\n]*) -->\n)?```(?P<kind>\w+)\n(?P<text>.*?)```\n"
    r"(?:```text\n(?P<printed>.*?)```\n)?",
    re.DOTALL,
)
TERMINAL = "in the first terminal"
CHANGES = re.compile(r"\b(?:signal|apply|sed|report)\b")
"""Words of blocks that are typed once."""


def pattern(printed: str) -> str:
    """A regular expression for what is printed: with other numbers, and columns that may be empty.

    A line ``...`` stands for any lines.
    """
    lines = []
    for line in printed.splitlines():
        cells = re.split(r"\s+", line.strip())
        words = [re.sub(r"\d+(?:\\[.:]\d+)*", r"[\\d.:]+", re.escape(cell)) for cell in cells]
        text = r"\s+".join(words)
        for empty in (r"\\-", r"\[\\d\.:\]\+\\s\+(?:%|[kMG]B|m?s|min)"):
            text = re.sub(rf"(?<=\\s\+){empty}(?=\\s|$)", r"(?:-|[\\d.]+ \\S+)", text)
        text = text.replace(r"\s+ms", r"\s+m?s")  # on a slower machine
        lines.append(r"(?:.*\n)*?" if line == "..." else rf"\s*{text}\s*\n")
    return "".join(lines)


def typed_in(text: str, folder: Path, environment: dict[str, str]) -> tuple[int, str]:
    """Type commands into a shell; the exit code, and what they print."""
    done = subprocess.run(
        ["bash", "-e", "-c", text],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
        check=False,
    )
    return done.returncode, done.stdout


def test_it_is_as_it_says(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PLAY_LAUNCH_LOG_DIR": str(tmp_path / "sessions"),
        "NO_COLOR": "1",
    }
    first: subprocess.Popen[bytes] | None = None
    family: list[psutil.Process] = []
    typed = 0
    try:
        for part in _PART.finditer(PAGE.read_text("utf-8")):
            about, kind, text = part["about"] or "", part["kind"], part["text"]
            if (part["note"] or "").endswith(TERMINAL):
                assert first is not None
                family = psutil.Process(first.pid).children(recursive=True)
                first.send_signal(signal.SIGINT)
                assert first.wait(60) == 128 + signal.SIGINT
            elif about.startswith("file: "):
                (tmp_path / about.removeprefix("file: ")).write_text(text, "utf-8")
            elif about == "first terminal":
                with (tmp_path / "first").open("wb") as out:
                    command = text.split()
                    first = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=out)
            elif kind == "sh" and not about.startswith("not run"):
                wanted = re.match(r"exits with (\d)", about)
                code, printed = int(wanted[1]) if wanted else 0, pattern(part["printed"] or "")
                said = ""

                def is_as_printed(
                    text: str = text, code: int = code, printed: str = printed
                ) -> bool:
                    nonlocal said
                    code_, said = typed_in(text, tmp_path, environment)
                    return code_ == code and re.search(printed, said) is not None

                # What was done before may take a moment to be seen.
                limit = 0.0 if CHANGES.search(text) else LIMIT
                try:
                    until(is_as_printed, "", limit)
                except AssertionError:
                    pytest.fail(f"{text}printed:\n{said}instead of {printed}")
                typed += 1
    finally:
        run("daemon", "stop")  # `graph check` has started it, for this and further questions
        if first is not None and first.poll() is None:
            first.send_signal(signal.SIGTERM)
            first.wait(60)
    assert typed >= 8
    assert not alive(family)
    assert "by_pointer=" in (tmp_path / "first").read_text("utf-8")
    assert "<html" in (tmp_path / "run.html").read_text("utf-8")
