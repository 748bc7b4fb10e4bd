"""A temporary folder that takes no files is reported, and does not end the run."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from play_launch.config.load import load_config
from play_launch.container.parameter_files import ParameterFileError, ParameterFiles
from tests.support.replay import COMMAND

CONFIG = """
version: 1
duration: 2 s
nodes:
  - {name: good, command: [sh, -c, "echo good runs; exec sleep 600"]}
  - {name: bad, command: [sleep, "600"], parameters: {long: %s}}
"""


def write(folder: Path) -> Path:
    config = folder / "system.yaml"
    config.write_text(CONFIG % ("x" * 50_000), encoding="utf-8")
    return config


def test_a_folder_that_is_not_there_is_an_error_of_that_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good, bad = load_config(write(tmp_path)).nodes
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    files = ParameterFiles()
    files.write([good, bad])
    assert files.of(good) is None
    with pytest.raises(ParameterFileError, match=r"No such file or directory; .* set TMPDIR"):
        files.of(bad)
    files.remove()


MOUNT = 'mount -t tmpfs -o size=16k tmpfs "$TMPDIR"'


def test_a_full_folder_is_an_error_of_that_node(tmp_path: Path) -> None:
    small = tmp_path / "small"
    small.mkdir()
    environment = {**os.environ, "TMPDIR": str(small)}
    # A mount of its own, which ends with the process.
    alone = [shutil.which("unshare") or "unshare", "--map-root-user", "--mount", "sh", "-c"]
    if subprocess.run([*alone, MOUNT], check=False, env=environment).returncode != 0:
        pytest.skip("no mounts here; the folder that is not there covers the same path")
    done = subprocess.run(
        [
            *(*alone, f'{MOUNT} && exec "$@"', "sh"),
            *(COMMAND, "replay", write(tmp_path), "--log-dir", tmp_path / "logs"),
        ],
        check=False,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert "Traceback" not in done.stdout + done.stderr
    assert done.returncode == 1
    assert "[/good] good runs" in done.stdout
    line = next(line for line in done.stdout.splitlines() if "TMPDIR" in line)
    assert "[/bad] " in line
    assert "No space left on device" in line
