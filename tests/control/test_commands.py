"""The installed commands on real sessions: containers, isolated nodes, processes of every kind."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from play_launch.control.protocol import REQUEST_LIMIT, encode
from play_launch.control.registration import LINKS, address_of
from play_launch.control.sessions import connect, connect_to
from play_launch.postmortem.past_session import PastSession
from play_launch.recording import topics
from tests.support.mounts import disk_of
from tests.support.replay import COMMAND, Replay, alive, replaying, run
from tests.support.scenes import ending
from tests.support.waiting import until

SYSTEM = """
version: 1
name: robot
stop: {{ask: 1 s, sigint: 500 ms, sigterm: 500 ms}}
containers:
  - name: chat
    container_type: isolated
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}}
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: other}}
  - name: shared
    namespace: /sensing
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: camera}}
nodes:
  - {{name: sleeper, command: [sleep, "1000"]}}
  - {{name: deaf, command: ["{python}", "{deaf}"]}}
"""
DEAF = """
import signal, time
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
print("deaf now", flush=True)
while True:
    time.sleep(1000)
"""
OTHER_PORTS = """
<profiles><participant profile_name="other" is_default_profile="true">
  <rtps><port><portBase>20000</portBase></port></rtps>
</participant></profiles>
"""
KINDS = ["output", "node", "process"]
UP = {"/talker": "loaded", "/other": "loaded", "/camera": "loaded"}


def ask(*arguments: str, code: int = 0) -> str:
    """Run a command to its end and return what it prints; it has to end with ``code``."""
    result = run(*arguments)
    assert result.returncode == code, (arguments, result.stdout, result.stderr)
    return result.stdout if code == 0 else result.stdout + result.stderr


def rows(*names: str) -> dict[str, dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(ask("ps", "--json", *names))
    return {row["name"]: row for row in found}


def pids() -> dict[str, Any]:
    return {name: row["pid"] for name, row in rows().items()}


@pytest.fixture(autouse=True)
def links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(LINKS, str(tmp_path / "links"))
    return tmp_path / "links"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    deaf = tmp_path / "deaf.py"
    deaf.write_text(DEAF, encoding="utf-8")
    path = tmp_path / "robot.yaml"
    path.write_text(SYSTEM.format(python=sys.executable, deaf=deaf), encoding="utf-8")
    return path


@contextlib.contextmanager
def running(config: Path, log_dir: Path, *arguments: str) -> Iterator[Replay]:
    with replaying(config, log_dir, "-q", *arguments) as replay:
        ask("wait", "--timeout", "60")
        yield replay


def test_what_runs_is_listed(config: Path, tmp_path: Path) -> None:
    with running(config, tmp_path / "logs"):
        found = rows()
        assert list(found) == [
            "/chat", "/talker", "/other", "/sensing/shared", "/camera", "/sleeper", "/deaf",
        ]  # fmt: skip
        kinds = [row["kind"] for row in found.values()]
        assert (
            kinds
            == ["container", "component", "component", "container", "component"] + ["process"] * 2
        )
        states = {name: row["state"] for name, row in found.items()}
        assert {states[name] for name in UP} == {"loaded"}
        assert {state for name, state in states.items() if name not in UP} == {"running"}
        assert found["/talker"]["container"] == "/chat"
        # An isolated node has a process of its own, in the memory of its container.
        own = found["/talker"]
        assert own["pid"] not in {None, found["/chat"]["pid"], found["/other"]["pid"]}
        assert found["/camera"]["pid"] == found["/sensing/shared"]["pid"]
        assert all(row["uptime_s"] >= 0 for row in found.values())
        until(lambda: rows("/chat")["/chat"]["cpu_percent"] is not None, "a sample")
        chat = rows("/chat")["/chat"]
        assert chat["memory_bytes"] > 1_000_000
        assert rows("/talker")["/talker"]["memory_bytes"] is None
        assert list(rows("/sensing/*", "sleeper")) == ["/sensing/shared", "/sleeper"]
        table = ask("ps").splitlines()
        assert table[0].split()[:3] == ["NAME", "KIND", "STATE"]
        assert table[2].startswith("  /talker")
        assert "did you mean /talker?" in ask("ps", "/talkr", code=2)


def test_actions_touch_only_what_they_are_about(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(config, tmp_path / "logs") as replay:
        before = pids()
        assert ask("reload", "talker") == "/talker: reloaded\n"
        assert ask("restart", "/sensing/*") == "/sensing/shared: restarted\n"
        assert ask("stop", "sleeper") == "/sleeper: stopped\n"
        ask("wait")
        after = pids()
        assert after["/sleeper"] is None
        changed = {name for name in before if before[name] != after[name]}
        assert changed == {"/talker", "/sensing/shared", "/camera", "/sleeper"}
        assert ask("start", "sleeper") == "/sleeper: started\n"
        assert ask("unload", "/chat:*") == "/talker: unloaded\n/other: unloaded\n"
        assert {row["state"] for row in rows("/chat:*").values()} == {"unloaded"}
        assert json.loads(ask("load", "/other", "--json"))[0] == {
            "name": "/other", "container": "/chat", "done": True, "reason": "",
        }  # fmt: skip
        # What was done already is done.
        assert ask("load", "/other") == "/other: loaded\n"
        monkeypatch.setattr(sys, "argv", ["/bin/tool", "token:=very_secret", "\ud800\n"])
        with connect_to(str(replay.bag.parent)) as client:
            client.ask("load", {"names": ["/other"]})
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    actions = [event for event in replay.seen if event["event"] == "action"]
    assert {event["phase"] for event in actions} == {"requested", "done"}
    session = PastSession(replay.bag)
    recorded = [each.event for each in session.events({topics.ACTIONS.name})]
    assert [event.action for event in recorded][:4] == ["reload", "reload", "restart", "restart"]  # type: ignore[union-attr]
    first = recorded[0]
    assert first.targets == ("/chat:/talker",)  # type: ignore[union-attr]
    assert (first.uid, first.command) == (os.geteuid(), "play-launch reload talker")  # type: ignore[union-attr]
    # What a client says, not what has its pid by then; and whatever it says can be recorded.
    assert recorded[-1].command == "tool token:=(redacted) ?"  # type: ignore[union-attr]
    shown = ask("inspect", str(replay.bag))
    assert "reload /chat:/talker: requested by user" in shown


def test_what_cannot_be_done_is_refused_with_the_reason(config: Path, tmp_path: Path) -> None:
    with running(config, tmp_path / "logs"):
        for arguments, code, words in (
            (("stop", "/talker"), 2, "is a composable node; use load, unload or reload"),
            (("reload", "/chat"), 2, "is not a composable node"),
            (("stop", "unknown"), 2, "no node or process named 'unknown'"),
            (("stop", "un\x1b[2Jknown"), 2, "no node or process named 'unknown'"),
            (("stop", "x" * 1001), 2, "names[0]: expected `str` of length <= 1000"),
            (("ps", *["/chat"] * 2001), 2, "names: expected `array` of length <= 2000"),
            (("signal", "NONSENSE", "/chat"), 2, "unknown signal"),
            (("signal", "USR1", "/camera"), 1, "not running as a separate process"),
            (("events", "--kind", "nonsense"), 2, "there are no events 'nonsense'"),
            (("start", "/chat", "--timeout", "-1"), 2, "cannot be negative"),
            (("wait", "--timeout", "nan"), 2, "expected a duration"),
            (("param", "get", "/talker", "rate", "--timeout", "1e300"), 2, "expected a duration"),
        ):
            assert words in ask(*arguments, code=code), arguments
        ask("stop", "chat")
        assert "start /chat first" in ask("load", "/talker", code=1)
        assert "its container has stopped" in ask("wait", "/talker", code=1)
        ask("wait")
        assert "/chat: started" in ask("start", "chat")
        ask("wait", "/talker")


def test_a_process_that_is_deaf_to_signals_is_stopped_all_the_same(
    config: Path, tmp_path: Path
) -> None:
    with running(config, tmp_path / "logs"):
        assert "deaf now" in ask("logs", "/deaf")
        found = psutil.Process(rows("/deaf")["/deaf"]["pid"])
        assert "not done within 0.2 s: /deaf" in ask("stop", "deaf", "--timeout", "0.2", code=4)
        assert ask("stop", "deaf") == "/deaf: stopped\n"
        assert not alive([found])
        assert rows("/deaf")["/deaf"]["signal"] == signal.SIGKILL
        with connect() as client:
            deaf, talker = client.ask("status", {"names": ["/deaf", "/talker"]})[::-1]
        assert (deaf["state"], deaf["wanted"], deaf["command"][0]) == (
            "exited",
            False,
            sys.executable,
        )
        assert "SIGKILL" in deaf["last_restarts"][-1]["cause"]
        assert deaf["output"][-1]["text"] == "deaf now"
        assert (talker["state"], talker["wanted"], talker["waits_for"]) == ("loaded", True, "")
        assert talker["declared"] == f"{config}:9"


@pytest.mark.parametrize(
    ("done", "code"),
    [
        ((("stop", "chat"), ("stop", "deaf"), ("unload", "camera")), 0),
        ((("signal", "KILL", "sleeper"),), 1),
        ((("signal", "KILL", "sleeper"), ("stop", "sleeper")), 0),
        ((("stop", "sleeper"), ("start", "sleeper"), ("signal", "KILL", "sleeper")), 1),
    ],
)
def test_what_a_person_stopped_does_not_count_in_the_exit_code(
    done: tuple[tuple[str, ...], ...], code: int, config: Path, tmp_path: Path
) -> None:
    config.write_text(f"{config.read_text()}  - {json.dumps(ending(tmp_path / 'end'))}\n")
    with running(config, tmp_path / "logs") as replay:
        for arguments in done:
            ask(*arguments)
            if arguments[:2] == ("signal", "KILL"):
                until(lambda: rows("/sleeper")["/sleeper"]["pid"] is None, "its end")
        (tmp_path / "end").touch()
        replay.read_all()
    assert replay.process.returncode == code


def test_a_session_of_which_all_was_stopped_goes_on(config: Path, tmp_path: Path) -> None:
    with running(config, tmp_path / "logs") as replay:
        ask("stop", "*")
        assert {row["pid"] for row in rows().values()} == {None}
        ask("start", "*")
        ask("wait")
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()


def test_events_and_logs_are_followed(config: Path, tmp_path: Path) -> None:
    with running(config, tmp_path / "logs") as replay:
        past = [json.loads(line) for line in ask("events", "--json").splitlines()]
        assert {"node", "container", "process", "component"} <= {each["event"] for each in past}
        assert all(each.keys() >= {"level", "source", "text"} for each in past)
        assert [each["stamp_ns"] for each in past] == sorted(each["stamp_ns"] for each in past)
        of_talker = [json.loads(line) for line in ask("events", "--json", "talker").splitlines()]
        assert of_talker
        assert {each.get("node", "/talker") for each in of_talker} == {"/talker"}
        lines = ask("logs", "/camera").splitlines()
        assert lines
        assert all("[camera]" in line for line in lines)
        assert "Hello" not in ask("logs", "--level", "error")
        assert ask("logs", "--since", "0s", "/deaf") == ""
        follower = subprocess.Popen(
            [str(COMMAND), "events", "-f", "--new", "--json"], stdout=subprocess.PIPE, text=True
        )
        assert follower.stdout is not None
        with ended(follower):
            until(lambda: bool(ask("reload", "/other")) and readable(follower), "an event")
            # Which of them comes first depends on when it began to follow.
            assert any(json.loads(line)["event"] == "action" for line in follower.stdout)
            replay.process.send_signal(signal.SIGINT)
            replay.read_all()
            # The end of the session ends it.
            assert follower.wait(30) == 0
            follower.stdout.read()


@contextlib.contextmanager
def ended(process: subprocess.Popen[str]) -> Iterator[None]:
    """End the process when the block raises."""
    with process:
        try:
            yield
        finally:
            if sys.exc_info()[0] is not None:
                process.kill()


def readable(process: subprocess.Popen[str]) -> bool:
    import select

    assert process.stdout is not None
    return bool(select.select([process.stdout], [], [], 0)[0])


def test_commands_in_a_terminal(config: Path, tmp_path: Path) -> None:
    def in_a_terminal(*arguments: str) -> bytes:
        child, terminal = pty.fork()
        if child == 0:
            os.execv(COMMAND, [str(COMMAND), *arguments])
        said = b""
        with contextlib.suppress(OSError):  # EIO: it has ended
            while data := os.read(terminal, 4096):
                said += data
        os.close(terminal)
        assert os.waitpid(child, 0)[1] == 0
        return said

    with running(config, tmp_path / "logs"):
        assert b"/sensing/shared  container" in in_a_terminal("ps")
        assert b"/talker: reloaded" in in_a_terminal("reload", "talker")
        assert b"/talker loaded" in in_a_terminal("events", "talker")


def test_a_killed_supervisor_leaves_a_socket_that_is_recognised(
    config: Path, tmp_path: Path
) -> None:
    with running(config, tmp_path / "logs") as replay:
        everything = replay.descendants()
        replay.process.kill()
        replay.process.wait()
        until(lambda: not alive(everything), "the end of the nodes")
    left = list((tmp_path / "logs").glob("*/control.sock"))
    assert len(left) == 2  # by way of `latest` as well
    assert "was killed, and left control.sock behind" in ask("ps", code=1)
    assert "was killed" in ask("ps", "--session", str(tmp_path / "logs" / "latest"), code=1)
    with running(config, tmp_path / "logs"):
        assert rows()["/chat"]["state"] == "running"


def test_a_session_on_a_full_disk_can_be_operated(config: Path, tmp_path: Path) -> None:
    with disk_of("8M", tmp_path / "disk") as disk, running(config, disk):
        with contextlib.suppress(OSError), (disk / "filler").open("wb", buffering=0) as file:
            while file.write(b"x" * 65536):
                pass
        assert ask("reload", "talker") == "/talker: reloaded\n"
        assert ask("stop", "sleeper") == "/sleeper: stopped\n"
        assert rows("/sleeper")["/sleeper"]["pid"] is None
        assert ask("logs", "/deaf")


def test_bad_clients_do_not_affect_the_run(config: Path, tmp_path: Path) -> None:
    with running(config, tmp_path / "logs") as replay, contextlib.ExitStack() as open_ones:
        folder = str((tmp_path / "logs" / "latest").resolve())
        before = pids()
        follow = encode({"id": 1, "op": "events", "arguments": {"follow": True, "kinds": KINDS}})
        for _ in range(50):
            open_ones.enter_context(connect_to(folder))._connection.sendall(follow)
        half = b'{"id": 1, "op": "diff", "arguments": {"config": "'
        half += b"x" * (REQUEST_LIMIT - len(half))
        for sent in [os.urandom(1000) + b"\n"] * 10 + [half] * 10 + [half + b"xx"] * 10:
            plain = open_ones.enter_context(socket.socket(socket.AF_UNIX))
            with address_of(folder) as address:
                plain.connect(address)
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it is refused
                plain.sendall(sent)
        for _ in range(20):
            connect_to(folder).close()
        until(lambda: ask("reload", "talker") == "/talker: reloaded\n", "a reload")
        after = pids()
        del before["/talker"], after["/talker"]
        assert after == before
        assert psutil.Process(replay.pid).memory_info().rss < 200_000_000


def test_of_two_sessions_one_is_chosen(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(
        "version: 1\nname: zweitös\nnodes: [{name: sleeper, command: [sleep, '1000']}]\n",
        encoding="utf-8",
    )
    monkeypatch.chdir(tmp_path)
    with running(config, tmp_path / "a") as first, replaying(other, Path("b")) as second:
        monkeypatch.chdir("/")  # where a relative --log-dir means another folder
        ask("wait", "--session", "zweitös", "--timeout", "60")
        assert "2 sessions are running; choose one with --session" in ask("ps", code=1)
        for session in ("zweitös", str(second.pid), str(tmp_path / "b" / "latest")):
            assert "/sleeper" in ask("ps", "--session", session)
            assert "/chat" not in ask("ps", "--session", session)
        assert "/chat" in ask("ps", "--session", str(first.pid))
        (tmp_path / "b").rename(tmp_path / "moved")
        assert "still runs" in ask("ps", "--session", str(second.pid), code=1)
        # The one that can be reached is not the one that is meant.
        refused = ask("stop", "*", code=1)
        assert "2 sessions are running" in refused
        assert "still runs" in refused
        (tmp_path / "moved").rename(tmp_path / "b")
        second.process.send_signal(signal.SIGSTOP)
        try:
            refused = ask("stop", "*", code=1)
            assert f"{first.pid}  robot" in refused
            assert re.search(rf"{second.pid}  the session in .* does not answer", refused)
            states = {row["state"] for row in json.loads(ask("ps", "--session=robot", "--json"))}
            assert states == {"running", "loaded"}
        finally:
            second.process.send_signal(signal.SIGCONT)


def test_parameters_are_read_and_set(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(config, tmp_path / "logs"):
        # Of another robot: with it the command would not meet the nodes of this one.
        (tmp_path / "profile.xml").write_text(OTHER_PORTS, encoding="utf-8")
        monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(tmp_path / "profile.xml"))
        values = json.loads(ask("param", "dump", "talker", "--json"))["/talker"]
        assert (values["rate"], values["text"]) == (10.0, "Hello World")
        # The type stays, also where the text looks like another one.
        for name, text, value in (("text", "true", "true"), ("rate", "20", 20.0)):
            ask("param", "set", "talker", name, text)
            found = json.loads(ask("param", "get", "talker", name, "--json"))
            assert found == {name: value}
            assert isinstance(found[name], type(value))
        refused = ask("param", "get", "chat", "rate", code=1)
        assert "processes have parameters: /chat is a container, running" in refused
        assert "has no parameter nothing" in ask("param", "get", "talker", "nothing", code=1)
        refused = ask("param", "set", "talker", "rate", "fast", code=1)
        assert "and the parameter is a double" in refused
        dumped = ask("param", "dump", "/talker", "/camera")
        assert "/talker:\n  ros__parameters:" in dumped
        with Path("/dev/full").open("w") as full:
            run("param", "dump", "/talker", code=2, capture_output=False, stdout=full)


def test_nodes_are_waited_for_and_parameters_offered(config: Path, tmp_path: Path) -> None:
    def offered(line: str) -> set[str]:
        words = ["play-launch", *line.split(" ")]
        asked = {"COMP_WORDS": "\n".join(words), "COMP_CWORD": str(len(words) - 1)}
        environment = {**os.environ, **asked, "_PLAY_LAUNCH_COMPLETE": "complete_bash"}
        return set(subprocess.check_output([COMMAND], text=True, env=environment).split())

    with running(config, tmp_path / "logs"):
        assert json.loads(ask("wait", "--for", "ready", "--json"))["reached"] is True
        overdue = ask("wait", "--for", "ready", "sleeper", "--timeout", "2", code=4)
        assert "not ready: /sleeper" in overdue
        # A session that does not answer at once, as on a busy machine, is left out.
        until(lambda: offered("param get talker ") >= {"rate", "text"}, "the node's answer")
        until(lambda: offered("param set /talker ra") == {"rate"}, "the same of a part")
        assert offered("param get /sleeper ") == set()
