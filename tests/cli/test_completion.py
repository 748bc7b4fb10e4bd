"""Keys pressed in real shells, beside real sessions."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import select
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from play_launch.control.registration import LINKS
from play_launch.control.sessions import connect_to
from tests.support.replay import COMMAND, Replay, finished, replaying, run
from tests.support.waiting import LIMIT, until

SYSTEM = """
version: 1
name: {name}
record: {{ros: false}}
nodes:
  - {{name: talker, command: [sleep, "1000"]}}
  - {{name: front, namespace: /sensing, command: [sleep, "1000"]}}
  - {{name: rear, namespace: /sensing, command: [sleep, "1000"]}}
"""
PREPARE_ZSH = """unsetopt zle_bracketed_paste; bindkey -e
 autoload -U compinit; compinit -u -D; source <(play-launch completion zsh)"""
SHELLS = {
    "bash": (["bash", "--norc", "--noprofile", "-i"], "source <(play-launch completion bash)"),
    "zsh": (["zsh", "-f", "-i"], PREPARE_ZSH),
    "fish": (["fish", "--no-config", "-i"], "play-launch completion fish | source"),
}
BEGIN_OF_LINE, END_OF_LINE, ALL = b"\x01", b"\x05", b"\x1b*"


class Terminal:
    """An interactive shell."""

    def __init__(self, shell: str, folder: Path) -> None:
        command, prepare = SHELLS[shell]
        self.pid, self._terminal = pty.fork()
        if self.pid == 0:
            os.chdir(folder)
            path = f"{COMMAND.parent}:{os.environ['PATH']}"
            keep = {"PATH": path, "TERM": "xterm", "PS1": "$ ", "HOME": str(folder)}
            os.execvpe(command[0], command, {**os.environ, **keep})
        self._said = b""
        self._send(f" {prepare}\n".encode())
        self.words(b"printf")

    def words(self, typed: bytes) -> list[str]:
        """Type a line and what completes it; return the words that the shell makes of it."""
        # In octal, so that what the shell echoes is not what it prints.
        show = rb" printf '\074\074%s\076\076' "
        self._send(typed + BEGIN_OF_LINE + show + END_OF_LINE + rb"; printf '\074end\076'" + b"\n")
        deadline = time.monotonic() + LIMIT
        while b"<end>" not in self._said:
            assert time.monotonic() < deadline, self._said
            if select.select([self._terminal], [], [], 1)[0]:
                self._said += os.read(self._terminal, 65536)
        said, _, self._said = self._said.partition(b"<end>")
        return re.findall(r"<<(.*?)>>", said.decode())

    def completes(self, typed: bytes, expected: list[str]) -> None:
        """Type a line until its keys give these words, in any order, after the first two.

        A session that does not answer in a fraction of a second, as on a busy machine, is left out.
        """
        deadline = time.monotonic() + LIMIT
        while sorted(words := self.words(typed)[2:]) != sorted(expected):
            assert time.monotonic() < deadline, (words, expected)

    def close(self) -> None:
        os.close(self._terminal)
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)

    def _send(self, keys: bytes) -> None:
        os.write(self._terminal, keys)


@pytest.fixture(autouse=True)
def links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(LINKS, str(tmp_path / "links"))
    return tmp_path / "links"


@pytest.fixture(params=list(SHELLS))
def terminal(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Terminal]:
    if shutil.which(request.param) is None:
        pytest.skip(f"{request.param} is not installed")
    terminal = Terminal(request.param, tmp_path)
    yield terminal
    terminal.close()


@contextlib.contextmanager
def running(folder: Path, name: str) -> Iterator[Replay]:
    config = folder / f"{name}.yaml"
    config.write_text(SYSTEM.format(name=name), encoding="utf-8")
    with replaying(config, folder / name, "-q") as replay:
        until(lambda: answers(folder / name / "latest"), "a session that answers")
        yield replay


def answers(folder: Path) -> bool:
    with contextlib.suppress(Exception), connect_to(str(folder.resolve())) as client:
        return len(client.ask("ps")) == 3
    return False


def offered(line: str) -> list[str]:
    words = ["play-launch", *line.split(" ")]
    asked = {"COMP_WORDS": "\n".join(words), "COMP_CWORD": str(len(words) - 1)}
    shown = run(code=0, env={**os.environ, **asked, "_PLAY_LAUNCH_COMPLETE": "complete_bash"})
    assert shown.stderr == ""
    return shown.stdout.split()


def until_offered(line: str, expected: set[str]) -> None:
    """Wait until these are offered; a session that answers late, as on a busy machine, is not."""
    until(lambda: set(offered(line)) == expected, f"{expected} after {line!r}")


def test_keys_complete_verbs_options_and_live_names(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "my_robot.yaml").touch()
    assert terminal.words(b"play-launch snap\t") == ["play-launch", "snapshot"]
    assert terminal.words(b"play-launch replay --dur\t1s")[2:] == ["--duration", "1s"]
    assert terminal.words(b"play-launch wait --for act\t")[2:] == ["--for", "active"]
    assert terminal.words(b"play-launch check my\t")[2:] == ["my_robot.yaml"]
    assert terminal.words(b"play-launch stop /talke\t")[2:] == ["/talke"], "no session, no name"
    with running(tmp_path, "robot"):
        terminal.completes(b"play-launch stop /tal\t", ["/talker"])
        terminal.completes(b"play-launch stop tal\t /sensing/f\t", ["talker", "/sensing/front"])
        terminal.completes(b"play-launch ps --session ro\t", ["--session", "robot"])
    assert terminal.words(b"play-launch stop /talke\t")[2:] == ["/talke"]


def test_a_session_that_hangs_offers_nothing_and_delays_no_command(tmp_path: Path) -> None:
    with running(tmp_path, "robot") as hanging:
        until_offered("stop /t", {"/talker"})
        hanging.process.send_signal(signal.SIGSTOP)
        try:
            assert offered("stop /t") == []
            with running(tmp_path, "second") as second:
                until_offered("stop /t", {"/talker"})
                until_offered("ps --session ", {"second", str(second.pid)})
        finally:
            hanging.process.send_signal(signal.SIGCONT)
        until_offered("stop /t", {"/talker"})
    assert offered("stop /t") == []
    assert offered("ps --session ") == []


def test_tab_imports_no_ros_and_only_the_command_on_the_line() -> None:
    program = (
        "import os, sys\n"
        "from play_launch.cli.app import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "slow = {'rclpy', 'launch', 'pydantic_core', 'asyncio', 'textual', 'mcap'}\n"
        "print(sorted(slow & set(sys.modules)))\n"
    )
    for line in ("", "st", "stop ", "replay --d"):
        words = ["play-launch", *line.split(" ")]
        asked = {"COMP_WORDS": "\n".join(words), "COMP_CWORD": str(len(words) - 1)}
        shown = finished(
            [sys.executable, "-c", program],
            code=0,
            env={**os.environ, **asked, "_PLAY_LAUNCH_COMPLETE": "complete_bash"},
        )
        assert shown.stdout.splitlines()[-1] == "[]"


def test_packages_and_their_launch_files_are_offered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "share/ament_index/resource_index/packages").mkdir(parents=True)
    (tmp_path / "share/ament_index/resource_index/packages/my_robot").touch()
    (tmp_path / "share/my_robot/launch").mkdir(parents=True)
    (tmp_path / "share/my_robot/launch/bringup.launch.py").write_text("raise SystemExit(1)")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert offered("launch my_r") == ["my_robot"]
    assert offered("dump my_robot ") == ["bringup.launch.py"]
