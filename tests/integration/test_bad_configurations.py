"""Some files of the corpus through the command: exit code 2, a located message, nothing started."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from tests.support.replay import run

CORPUS = Path(__file__).resolve().parents[1] / "config" / "corpus"
FILES = sorted(CORPUS.glob("*.yaml"))
# In a process of its own each; the others are read in one go by tests/config.
SAMPLE = FILES[:: len(FILES) // 5]


def refused(config: Path, tmp_path: Path) -> str:
    # What a start would leave: a session folder, or a process that says that it ran.
    started = tmp_path / "started"
    result = run(
        "replay",
        config.name,
        "--log-dir",
        tmp_path / "logs",
        cwd=config.parent,
        env={**os.environ, "STARTED": str(started)},
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


def test_one_mistake_keeps_all_the_rest_from_starting(tmp_path: Path) -> None:
    config = tmp_path / "half.yaml"
    config.write_text(
        "version: 1\nnodes:\n"
        '  - {name: good, command: [sh, -c, "touch $STARTED"]}\n'
        "  - {name: bad, comand: [true]}\n",
        encoding="utf-8",
    )
    assert "half.yaml:4:" in refused(config, tmp_path)
