"""What is asked, and what is saved, while another configuration is being applied."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

from mcap.reader import make_reader

from tests.support.replay import COMMAND, replaying, run
from tests.support.scenes import written
from tests.support.waiting import until

DEAF = "trap '' INT; echo deaf; while :; do sleep 0.1; done"


def write(path: Path, text: str) -> Path:
    deaf = {"name": "deaf", "command": ["sh", "-c", f"{DEAF} {text}"]}
    return written(path, stop={"sigint": "10 min"}, nodes=[deaf])


def test_diff_says_that_a_configuration_is_being_applied(tmp_path: Path) -> None:
    before, after = write(tmp_path / "before.yaml", "# 1"), write(tmp_path / "after.yaml", "# 2")
    with replaying(before, tmp_path / "logs") as replay:
        deaf = replay.until(text="deaf")
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
        last = replay.until(text="deaf")
        os.kill(last["pid"], signal.SIGKILL)


def test_what_is_saved_meanwhile_is_applied_afterwards(tmp_path: Path) -> None:
    watched, other = write(tmp_path / "watched.yaml", "# 1"), write(tmp_path / "other.yaml", "# 2")

    with replaying(watched, tmp_path / "logs", "--watch") as replay:
        pid = replay.until(text="deaf")["pid"]
        session = ["--session", str(replay.pid)]
        until(lambda: diff(watched, *session)[0] == 0, "a session that answers")
        command = [str(COMMAND), "apply", str(other), "--timeout", "600", *session]
        applying = subprocess.Popen(command)
        until(lambda: diff(watched, *session)[0] == 1, "a configuration that is applied")
        write(watched, "# 3")
        os.kill(pid, signal.SIGKILL)
        assert applying.wait(60) == 0
        for text in ("# 2", "# 3"):
            pid = replay.until(text="deaf")["pid"]
            words = Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8").split("\0")
            assert words[2].endswith(text)
            if text == "# 2":
                replay.until(event="process", kind="stopping")
            os.kill(pid, signal.SIGKILL)


def test_of_two_that_are_asked_for_at_once_one_is_applied(tmp_path: Path) -> None:
    files = [write(tmp_path / f"{number}.yaml", f"# {number}") for number in range(3)]
    with replaying(files[0], tmp_path / "logs") as replay:
        deaf = replay.until(text="deaf")
        session = ["--session", str(replay.pid)]
        until(lambda: diff(files[0], *session)[0] == 0, "a session that answers")
        command = [str(COMMAND), "apply", "--timeout", "600", *session]
        first = subprocess.Popen([*command, str(files[1])])
        until(lambda: diff(files[0], *session)[0] == 1, "a configuration that is applied")
        second = subprocess.run(
            [*command, str(files[2])], check=False, stderr=subprocess.PIPE, text=True, timeout=60
        )
        assert second.returncode == 1
        assert "another configuration is being applied; try again" in second.stderr
        assert json.loads(diff(files[2], *session, "--json")[1])["applying"] == str(files[1])
        os.kill(deaf["pid"], signal.SIGKILL)
        assert first.wait(60) == 0
        assert diff(files[1], *session) == (0, "nothing differs\n")
        last = replay.until(text="deaf")
        os.kill(last["pid"], signal.SIGKILL)
    # Of each configuration that was applied there is a copy in the recording.
    with replay.bag.open("rb") as stream:
        copies = [each.name for each in make_reader(stream).iter_attachments()]
    copied = {each.split("/")[1] for each in copies if each.startswith("applied/")}
    assert copied == {"1"}


def diff(*words: str | Path) -> tuple[int, str]:
    done = run("diff", *words)
    return done.returncode, done.stdout
