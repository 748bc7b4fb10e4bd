"""Who compares while another configuration is being applied is told so."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

from tests.support.replay import COMMAND, replaying
from tests.support.waiting import until

DEAF = "trap '' INT; echo deaf; while :; do sleep 0.1; done"


def write(path: Path, text: str) -> Path:
    node = {"name": "deaf", "command": ["sh", "-c", f"{DEAF} {text}"]}
    limits = {"sigint": "10 min"}
    path.write_text(json.dumps({"version": 1, "stop": limits, "nodes": [node]}), encoding="utf-8")
    return path


def test_diff_says_that_a_configuration_is_being_applied(tmp_path: Path) -> None:
    before, after = write(tmp_path / "before.yaml", "# 1"), write(tmp_path / "after.yaml", "# 2")
    with replaying(before, tmp_path / "logs") as replay:
        deaf = replay.read_until(lambda each: each.get("text") == "deaf", "a deaf process")
        session = ["--session", str(replay.pid)]
        until(lambda: diff(before, *session)[0] == 0, "a session that answers")
        applying = subprocess.Popen(
            [str(COMMAND), "apply", str(after), "--timeout", "600", *session]
        )
        until(lambda: diff(before, *session)[0] == 1, "a configuration that is applied")
        said = diff(before, *session)[1], diff(before, *session, "--json")[1]
        os.kill(deaf["pid"], signal.SIGKILL)
        assert applying.wait(60) == 0
        assert f"{after} is being applied; compared with" in said[0]
        assert json.loads(said[1])["applying"] == str(after)
        assert diff(after, *session) == (0, "nothing differs\n")
        last = replay.read_until(lambda each: each.get("text") == "deaf", "the next process")
        os.kill(last["pid"], signal.SIGKILL)


def diff(*arguments: str | Path) -> tuple[int, str]:
    command = [str(COMMAND), "diff", *map(str, arguments)]
    run = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    return run.returncode, run.stdout
