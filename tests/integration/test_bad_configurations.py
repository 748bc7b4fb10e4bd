"""Every file of the corpus through the command: exit code 2, a located message, nothing started."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from tests.support.replay import COMMAND

CORPUS = Path(__file__).resolve().parents[1] / "config" / "corpus"
FILES = sorted(CORPUS.glob("*.yaml"))
# In a process of its own each; the others are read in one go by tests/config.
SAMPLE = FILES[:: max(1, len(FILES) // 45)]


def test_the_corpus_is_large_enough() -> None:
    assert len(SAMPLE) >= 40


def refused(config: Path, tmp_path: Path) -> str:
    # What a start would leave: a session folder, or a process that says that it ran.
    started = tmp_path / "started"
    result = subprocess.run(
        [COMMAND, "replay", config.name, "--log-dir", tmp_path / "logs"],
        cwd=config.parent,
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, "STARTED": str(started)},
        timeout=60,
    )
    assert result.returncode == 2, result.stdout + result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "logs").exists()
    assert not started.exists()
    return result.stderr


@pytest.mark.parametrize("config", SAMPLE, ids=lambda path: path.stem)
def test_a_bad_file_is_refused_with_its_place(config: Path, tmp_path: Path) -> None:
    message = refused(config, tmp_path)
    # The mistake may be in a parameter file that the configuration names.
    assert re.search(r"^\S+\.yaml:\d+:\d+: (\S+|\(top level\)): ", message, re.MULTILINE), message


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff\xfe\x00", b"version: 1\ncontainers:\n  - name: \xff\n", b"a: [" * 2_500_000],
    ids=["empty", "utf-16", "broken utf-8", "10 MB"],
)
def test_what_is_no_text_is_refused_too(content: bytes, tmp_path: Path) -> None:
    config = tmp_path / "bad.yaml"
    config.write_bytes(content)
    message = refused(config, tmp_path)
    assert re.search(r"^bad\.yaml:\d+:\d+: ", message, re.MULTILINE), message


def test_one_mistake_keeps_all_the_rest_from_starting(tmp_path: Path) -> None:
    config = tmp_path / "half.yaml"
    config.write_text(
        "version: 1\nnodes:\n"
        '  - {name: good, command: [sh, -c, "touch $STARTED"]}\n'
        "  - {name: bad, comand: [true]}\n",
        encoding="utf-8",
    )
    assert "half.yaml:4:" in refused(config, tmp_path)
