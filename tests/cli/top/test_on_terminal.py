"""The installed command on a terminal, before real sessions: what a person sees and gets back."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from play_launch.cli.output import printable
from play_launch.control.registration import LINKS
from tests.support.replay import COMMAND, Replay, finished, replaying, run
from tests.support.scenes import TALKER_AND_SLEEPER
from tests.support.terminal import Terminal, on_terminal
from tests.support.waiting import until

SMALL = """
version: 1
name: small
nodes:
  - {name: sleeper, command: [sleep, "1000"]}
"""
LOUD = """
import sys, time
sys.stdout.write("".join(f"\\x1b[2J\\x1b[31mearly {number}\\r\\n" for number in range(9000)))
number = 0
while True:
    sys.stdout.write("".join(f"\\x1b[2J late {number} \\x1b]0;x\\x07\\n" for _ in range(50)))
    sys.stdout.flush()
    number += 1
    time.sleep(0.05)
"""
COLOURS = re.compile(rb"\x1b\[(?:\d+;)*(?:3[0-8]|4[0-8]|9[0-7]|10[0-7])(?:;\d+)*m")
DOWN = "\x1b[B"


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@contextlib.contextmanager
def running(config: Path, log_dir: Path) -> Iterator[Replay]:
    with replaying(config, log_dir, "-q") as replay:
        wait = [str(COMMAND), "wait", "--session", str(replay.pid), "--timeout", "90"]
        subprocess.run(wait, check=True, capture_output=True)
        yield replay


@pytest.fixture(scope="module", autouse=True)
def links(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(LINKS, str(tmp_path_factory.mktemp("links")))
        yield


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory, links: None) -> Iterator[Replay]:
    folder = tmp_path_factory.mktemp("robot")
    with running(write(folder / "robot.yaml", TALKER_AND_SLEEPER), folder / "logs") as replay:
        yield replay


def top(*arguments: str, **how: Any) -> contextlib.AbstractContextManager[Terminal]:
    return on_terminal(str(COMMAND), "top", *arguments, **how)


def top_of(replay: Replay, **how: Any) -> contextlib.AbstractContextManager[Terminal]:
    return top("--session", str(replay.pid), **how)


def pids(replay: Replay) -> dict[str, int]:
    done = run("ps", "--json", "--session", str(replay.pid), code=0)
    return {row["name"]: row["pid"] for row in json.loads(done.stdout)}


def test_a_person_sees_what_runs_restarts_some_of_it_and_leaves(robot: Replay) -> None:
    before = pids(robot)
    with top_of(robot) as terminal:
        terminal.until_seen("/sleeper")
        for name, state in (("/chat", "running"), ("  /talker", "loaded"), ("/sleeper", "running")):
            assert terminal.line(name).split()[1:3] == [state, str(before[name.strip()])]
        terminal.until_seen("talker: publishing")
        terminal.press(DOWN * 2)
        terminal.until_seen("/sleeper, process")
        terminal.press("r")
        terminal.until_seen("restart /sleeper?")
        assert pids(robot) == before
        terminal.press("y")
        terminal.until_seen("/sleeper: restarted")
        after = pids(robot)
        assert {name for name in before if before[name] != after[name]} == {"/sleeper"}
        until(lambda: str(after["/sleeper"]) in terminal.line("/sleeper"), "the new pid")
        terminal.press("/talk\r")
        until(lambda: "/sleeper" not in "".join(terminal.lines()[2:8]), "the choice")
        terminal.press("r")
        terminal.until_seen("reload /talker?")
        terminal.press("y")
        terminal.until_seen("/talker: reloaded")
        terminal.press("q")
        assert terminal.end() == 0
        assert terminal.is_restored()
    assert pids(robot) == after, "the session continues"


@pytest.mark.parametrize(
    ("end", "code"),
    [
        (lambda terminal: terminal.process.send_signal(signal.SIGTERM), 143),
        (lambda terminal: terminal.process.send_signal(signal.SIGHUP), 129),
        (lambda terminal: terminal.process.send_signal(signal.SIGINT), 130),
        (lambda terminal: terminal.press("\x03"), 130),
    ],
    ids=["SIGTERM", "SIGHUP", "SIGINT", "Ctrl-C"],
)
def test_the_terminal_is_given_back_whatever_ends_it(
    robot: Replay, end: Callable[[Terminal], None], code: int
) -> None:
    with top_of(robot) as terminal:
        terminal.until_seen("/sleeper")
        # Also while something is asked.
        terminal.press("x")
        terminal.until_seen("stop /chat?")
        end(terminal)
        assert terminal.end() == code
        assert terminal.is_restored()
    assert robot.process.poll() is None


@pytest.mark.parametrize("before", ["", "trap '' HUP; "], ids=["", "SIGHUP ignored"])
def test_a_window_that_is_closed_ends_it(robot: Replay, before: str) -> None:
    command = f"{before}exec {COMMAND} top --session {robot.pid}"
    with on_terminal("sh", "-c", command) as terminal:
        terminal.until_seen("/sleeper")
        terminal.hang_up()
        assert terminal.process.wait(60) in {129, -signal.SIGHUP}
    assert robot.process.poll() is None


@pytest.mark.parametrize("environment", [{"NO_COLOR": "1"}, {"TERM": "vt100"}], ids=str)
def test_without_colours_nothing_is_lost(robot: Replay, environment: dict[str, str]) -> None:
    known = [sys.executable, "-c", "import curses; curses.setupterm('vt100', 1)"]
    if "TERM" in environment and subprocess.run(known, check=False).returncode:
        pytest.skip("terminfo does not know vt100 here")
    with top_of(robot, **environment) as terminal:
        terminal.until_seen("/sleeper")
        until(lambda: terminal.look(2, 0).reverse, "the selected row")
        for opens, closes, text in (("x", "n", "y yes"), ("?", "?", "leave; the session")):
            terminal.press(opens)
            terminal.until_seen(text)
            terminal.press(closes)
            terminal.until_gone(text)
        assert not COLOURS.search(terminal.raw)
        terminal.press("q")
        assert terminal.end() == 0
    with top_of(robot) as terminal:
        terminal.until_seen("/sleeper")
        until(lambda: bool(COLOURS.search(terminal.raw)), "colours")


def test_where_no_screen_can_be_the_error_names_what_needs_none(robot: Replay) -> None:
    command = [str(COMMAND), "top", "--session", str(robot.pid)]
    piped = finished(command)
    assert (piped.returncode, piped.stdout) == (2, "")
    assert "standard output is not one; play-launch ps lists" in piped.stderr
    with top_of(robot, TERM="dumb") as terminal:
        assert terminal.end() == 2
        assert "TERM=dumb cannot" in " ".join(terminal.lines())
        assert b"\x1b[" not in terminal.raw


def test_without_textual_the_error_names_the_extra(robot: Replay) -> None:
    program = "import sys; sys.modules['textual'] = None; from play_launch.cli.entry import main"
    command = (sys.executable, "-c", f"{program}; main()", "top", "--session", str(robot.pid))
    with on_terminal(*command) as terminal:
        assert terminal.end() == 2
        assert "pip install 'play-launch-py[top]'" in "".join(terminal.lines())


@pytest.mark.parametrize(
    ("number", "code", "text"),
    [
        (signal.SIGINT, 0, "the session small (pid {pid}) has ended"),
        (signal.SIGKILL, 1, "error: the supervisor of the session small (pid {pid}) was killed"),
    ],
)
def test_the_end_of_the_session_is_reported(
    tmp_path: Path, number: signal.Signals, code: int, text: str
) -> None:
    config = write(tmp_path / "small.yaml", SMALL)
    with running(config, tmp_path / "logs") as replay, top_of(replay) as terminal:
        terminal.until_seen("/sleeper")
        replay.process.send_signal(number)
        assert terminal.end() == code
        assert terminal.is_restored()
        shown = printable(terminal.raw.decode().rpartition("\x1b[?1004l")[2])
        assert shown.strip() == text.format(pid=replay.pid)


def test_a_stopped_supervisor_does_not_freeze_the_keys(tmp_path: Path) -> None:
    config = write(tmp_path / "small.yaml", SMALL)
    with running(config, tmp_path / "logs") as replay, top_of(replay) as terminal:
        terminal.until_seen("/sleeper")
        replay.process.send_signal(signal.SIGSTOP)
        try:
            terminal.until_seen("no answer for")
            terminal.press("?")
            terminal.until_seen("the session continues")
            terminal.press("q")
            terminal.until_gone("the session continues")
            terminal.press("x")
            terminal.until_seen("stop /sleeper?")
            terminal.press("y")
            terminal.until_seen("stop /sleeper: in progress")
        finally:
            replay.process.send_signal(signal.SIGCONT)
        terminal.until_seen("/sleeper: stopped")
        terminal.until_gone("no answer for")
        replay.process.send_signal(signal.SIGSTOP)
        try:
            terminal.press("q")
            assert terminal.end() == 0
        finally:
            replay.process.send_signal(signal.SIGCONT)


def test_110_nodes_of_which_one_writes_all_the_time(tmp_path: Path) -> None:
    loud = write(tmp_path / "loud.py", LOUD)
    nodes = [{"name": f"node_{number:03}", "command": ["sleep", "1000"]} for number in range(109)]
    nodes.append({"name": "loud", "command": [sys.executable, str(loud)]})
    config = write(
        tmp_path / "many.yaml", json.dumps({"version": 1, "name": "many", "nodes": nodes})
    )
    with running(config, tmp_path / "logs") as replay:
        with top_of(replay) as terminal:
            terminal.until_seen("/node_000")
            terminal.press("\x1b[F")  # End
            terminal.until_seen("/loud, process")
            until(lambda: "late" in terminal.line("/loud  "), "its last line")
            # More came than is kept, and none of it moved the cursor or changed the title.
            terminal.until_seen("older than the last 5,000 kept")
            assert b"\x1b]0;x" not in terminal.raw
            terminal.resize(50, 12)
            until(lambda: not terminal.line("LAST LINE"), "the narrow table")
            until(lambda: "/loud" in terminal.lines()[5], "the smaller table")
            assert "LAST LINE" not in "".join(terminal.lines())
            terminal.press("?")
            terminal.until_seen("Up Down scroll")
            terminal.press("\x1b[F")
            terminal.until_seen("q, Ctrl-C")
            terminal.press("?")
            terminal.until_gone("Up Down scroll")
            terminal.resize(120, 40)
            until(lambda: len(terminal.line("LAST LINE")) > 40, "the larger table")
            terminal.until_seen("/node_108")
            # A terminal that takes nothing for a while is drawn when it does again.
            terminal.is_reading.clear()
            terminal.press("/node_10")
            said = psutil.Process(terminal.process.pid)
            began = said.cpu_times().user
            until(lambda: said.cpu_times().user > began + 0.05, "work without a viewer")
            terminal.is_reading.set()
            terminal.until_seen("names: node_10")
            until(lambda: terminal.line("/node_105") != "", "the chosen rows")
            # One that never does again holds nothing up either.
            terminal.is_reading.clear()
            until(lambda: terminal.unread() > 2000, "output that waits")
            terminal.process.send_signal(signal.SIGTERM)
            # In order, if the terminal had room for that.
            assert terminal.process.wait(60) in {-signal.SIGTERM, 143}
            assert terminal.has_old_settings()
        assert replay.process.poll() is None
