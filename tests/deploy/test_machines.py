"""Systems on several machines: hosts are network namespaces, reached by ssh."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest

from play_launch import ExitCode
from play_launch.deploy.machines.namespaces import missing
from tests.support.hosts import Hosts, running, supervisors, system
from tests.support.replay import is_
from tests.support.waiting import until

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"hosts: {missing()}")


def test_one_view_and_one_end_of_three_machines(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "trio", more="expect: {/chatter: {min_rate: 1, machine: h3}}\n")
    with running(net, config) as trio:
        rows = trio.loaded().rows()
        (parts,) = (net.folder / "home2").glob(".cache/play-launch")
        assert parts.stat().st_mode & 0o77 == 0
        assert {name: row["machine"] for name, row in rows.items()} == {
            "/talk": "h2",
            "/talker": "h2",
            "/listen": "h3",
            "/listener": "h3",
            "/clock": "main",
            "/ticks": "h3",
        }
        assert "/listener" in trio.ask("status", "listener")
        until(lambda: "World" in trio.ask("logs", "listener"), "a line of the listener")
        until(lambda: "as expected" in trio.ask("expect", code=None), "its topic")
        assert "h3       /chatter" in trio.ask("expect")
        trio.ask("restart", "listen")
        trio.ask("stop", "nothing_like_it", code=2)
        trio.ask("start", "*")
        trio.ask("load", "*")
        assert "is a composable node; use load" in trio.ask("stop", "listener", code=2)
        system(tmp_path, "other", talker="talker2").rename(config)
        config.write_text(config.read_text().replace("name: other", "name: trio"))
        trio.ask("diff", str(config), code=1)
        trio.ask("apply", str(config))
        after = trio.rows()
        assert "/talker2" in after
        assert "/talker" not in after
        assert after["/clock"]["pid"] == rows["/clock"]["pid"]
        assert after["/talk"]["pid"] == rows["/talk"]["pid"]
        trio.stop()
        events = [
            (each["machine"], each.get("kind"))
            for each in trio.events()
            if each.get("name") in {"/talk", "/listen"}
            and each.get("kind") in {"started", "stopping"}
        ]
        # It is started after what it depends on, and stopped before that.
        assert events.index(("h2", "started")) < events.index(("h3", "started"))
        assert events.index(("h3", "stopping")) < events.index(("h2", "stopping"))
    assert not supervisors(net, 2)
    assert not supervisors(net, 3)


def test_a_page_shows_all_machines(net: Hosts, tmp_path: Path) -> None:
    get = "import sys, urllib.request as r; print(r.urlopen(sys.argv[1]).read().decode())"
    with running(net, system(tmp_path, "paged", more="web: {port: 0}\n")) as paged:
        paged.loaded()

        def lines() -> list[dict[str, Any]]:
            return [each for each in paged.events() if each.get("process") == "page"]

        until(lambda: bool(lines()), "the address of the page")
        (line,) = lines()
        url = f"{line['text'].split()[0]}metrics"
        command = net.command(sys.executable, "-c", get, url)

        def metrics() -> str:
            return subprocess.run(command, capture_output=True, text=True, check=False).stdout

        until(lambda: 'machine="h3",play_launch_unit_state="up"' in metrics(), "h3 on the page")
        assert 'kind="component",machine="h2",unit="/talk:/talker"' in metrics()
        assert "play_launch_session_start_seconds" in metrics()
        paged.stop()
        assert not psutil.pid_exists(line["pid"])


def test_a_cut_loses_no_line_and_stops_nothing(net: Hosts, tmp_path: Path) -> None:
    with running(net, system(tmp_path, "cut")) as cut:
        rows = cut.loaded().rows()
        until(lambda: bool(cut.ticks()), "a line")
        net.set_link(3, "down")
        wait = net.play_launch("wait", "--timeout", "40s", "--session", str(cut.process.pid))
        waiting = subprocess.Popen(wait, env=net.environment, stdin=subprocess.DEVNULL)
        try:
            until(lambda: cut.rows()["/listener"]["state"] == "unreachable", "the loss")
            assert "was loaded" in cut.rows()["/listener"]["reason"]
            assert "unreachable" in cut.ask("restart", "listen", code=1)
            assert "unreachable since" in cut.ask("status", "listener", code=3)
            assert cut.ask("events", "listener")
            assert "unreachable" in cut.ask("wait", "--timeout", "100ms", code=4)
            assert cut.rows()["/talker"]["state"] == "loaded"
        finally:
            net.set_link(3, "up")
        assert waiting.wait(40) == 0
        until(lambda: cut.rows()["/listener"]["state"] == "loaded", "the return")
        assert cut.rows()["/listener"]["pid"] == rows["/listener"]["pid"]
        seen = cut.ticks()[-1]
        until(lambda: cut.ticks()[-1] > seen, "the next line")
        assert (ticks := cut.ticks()) == list(range(1, len(ticks) + 1))
        cut.stop()
    explained = net.run("explain", code=1).stdout
    assert "machine h3 could not be reached at " in explained
    assert "\n  Cause: the connection is lost: " in explained


NOTES_COLLECTING = """\
import atexit, gc, pathlib, sys
def note():
    if "replay" in sys.argv and "--machine" not in sys.argv:
        pathlib.Path(NOTE).write_text(str(gc.isenabled()))
atexit.register(note)
"""


def test_garbage_is_collected_in_a_coordinator(
    net: Hosts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    note = tmp_path / "collects"
    source = NOTES_COLLECTING.replace("NOTE)", f"{str(note)!r})")
    (tmp_path / "sitecustomize.py").write_text(source)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with running(net, system(tmp_path, "collecting")) as collecting:
        collecting.loaded()
        collecting.stop()
    assert note.read_text() == "True", "each lost connection leaves cycles of objects"


def test_all_machines_end_after_the_duration(net: Hosts, tmp_path: Path) -> None:
    done = net.run("replay", str(system(tmp_path, "short")), "--duration", "2s")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "[h3 /ticks] tick 1" in done.stdout
    assert not supervisors(net, 2)


def test_a_machine_that_ends_while_it_is_cut_has_ended(net: Hosts, tmp_path: Path) -> None:
    with running(net, system(tmp_path, "timed", more="duration: 5 s\n")) as timed:
        timed.loaded()
        net.set_link(3, "down")
        try:
            until(lambda: not supervisors(net, 3), "the end of its session")
            until(lambda: "h3 is unreachable" in timed.printed(), "the lost connection")
        finally:
            net.set_link(3, "up")
        assert timed.process.wait(40) == 0, timed.printed()
        texts = [each.get("text", "") for each in timed.events()]
        assert len([each for each in texts if "h3 is unreachable" in each]) == 1


def test_detached_machines_run_on_and_the_next_replay_adopts_them(
    net: Hosts, tmp_path: Path
) -> None:
    (tmp_path / "tool").write_text("#!/bin/sh\n")
    (tmp_path / "tool").chmod(0o755)
    config = system(tmp_path, "apart", h3=", copy: [tool]")
    net.run("replay", str(config), "--detach", code=0)
    (tool,) = net.folder.glob(f"home3/.cache/play-launch/parts/apart-h3/files{tmp_path}/tool")
    assert tool.stat().st_mode & 0o777 == 0o700
    pids = supervisors(net, 2), supervisors(net, 3)
    assert all(pids)
    text = (
        config.read_text()
        .replace("machine: h2", "machine: x")
        .replace("machine: h3", "machine: h2")
    )
    config.write_text(text.replace("machine: x", "machine: h3"))
    with running(net, config) as heir:
        rows = heir.loaded().rows()
        # What came to h2 waits for what came to h3.
        assert (rows["/listener"]["machine"], rows["/talker"]["machine"]) == ("h2", "h3")
        assert (supervisors(net, 2), supervisors(net, 3)) == pids
        heir.process.kill()
        heir.process.wait()
    lines = config.read_text().replace("machine: h3", "machine: h2").splitlines()
    config.write_text("\n".join(each for each in lines if not each.startswith("  h3:")))
    with running(net, config) as smaller:
        rows = smaller.loaded().rows()
        assert rows["/talker"]["machine"] == "h2"
        assert "h3: what an earlier run has left there was ended" in smaller.printed()
        assert (supervisors(net, 2), supervisors(net, 3)) == (pids[0], [])
        smaller.stop()


def test_on_exit_shutdown_of_one_machine_ends_all(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "ends")
    text = config.read_text().replace("command: [bash", "on_exit: shutdown\n    command: [bash")
    config.write_text(text.replace("while :; do", "while [ $i -lt 40 ]; do"))
    done = net.run("replay", str(config))
    assert "h3 ends the whole system (on_exit: shutdown)" in done.stdout
    assert not supervisors(net, 2)


def test_a_configuration_that_was_only_compared_is_not_started(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "same")
    with running(net, config) as same:
        same.loaded()
        other = system(tmp_path, "other", talker="talker2")
        other.write_text(other.read_text().replace("name: other", "name: same"))
        same.ask("diff", str(other), code=1)
        (pid,) = supervisors(net, 2)
        os.kill(pid, signal.SIGKILL)
        until(lambda: "started anew" in same.printed(), "the new session")
        same.loaded()
        assert "/talker" in same.rows()
        same.ask("apply", str(other))
        (pid,) = supervisors(net, 2)
        os.kill(pid, signal.SIGKILL)
        same.loaded()  # a machine that is lost is waited for
        assert "/talker2" in same.rows()
        same.stop()


def test_a_coordinator_that_was_killed_is_followed_by_one_that_adopts(
    net: Hosts, tmp_path: Path
) -> None:
    config = system(tmp_path, "heir")
    with running(net, config) as first:
        before = first.loaded().rows()
        first.process.kill()
        first.process.wait()
    with running(net, config) as second:
        rows = second.loaded().rows()
        assert {name: row["pid"] for name, row in rows.items()} == {
            name: row["pid"] for name, row in before.items()
        }
        second.stop()
    assert not supervisors(net, 2)


def test_a_session_that_is_killed_again_and_again_is_given_up(net: Hosts, tmp_path: Path) -> None:
    with running(net, system(tmp_path, "hopeless")) as hopeless:

        def changes() -> list[dict[str, Any]]:
            events = (each for each in hopeless.events() if each["event"] == "machine")
            return [
                each
                for each in events
                if each["machine"] == "h3" and each["state"] in {"running", "failed"}
            ]

        hopeless.loaded()
        for number in range(2, 7):
            (pid,) = supervisors(net, 3)
            os.kill(pid, signal.SIGKILL)
            until(lambda: len(changes()) == number, f"start {number}")  # noqa: B023
        assert "h3 has failed: its session was killed again and again" in changes()[-1]["text"]
        assert hopeless.rows()["/talker"]["state"] == "loaded"
        hopeless.stop(1)
    assert not supervisors(net, 3)


def test_a_supervisor_that_hangs_holds_up_no_other_machine(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "hung", more="expect: {/chatter: {min_rate: 1, machine: h2}}")
    with running(net, config) as hung:
        hung.loaded()
        (pid,) = supervisors(net, 3)
        os.kill(pid, signal.SIGSTOP)
        try:
            rows = hung.rows()
            assert "h2       /chatter" in hung.ask("expect", code=None)
        finally:
            os.kill(pid, signal.SIGCONT)
        assert rows["/talker"]["state"] == "loaded"
        assert rows["/listener"]["state"] == "unreachable"
        until(lambda: hung.rows()["/listener"]["state"] == "loaded", "its answer")
        hung.stop()


def test_a_part_that_runs_is_not_started_a_second_time(net: Hosts, tmp_path: Path) -> None:
    with running(net, system(tmp_path, "twin")) as twin:
        twin.loaded()
        (script,) = net.folder.glob("home2/.cache/play-launch/parts/twin-h2/start.sh")
        done = subprocess.run(
            net.command("bash", str(script), host=2),
            env=net.environment,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert "is being started already" in done.stdout
        assert len(supervisors(net, 2)) == 1
        twin.stop()


def test_without_its_coordinator_a_machine_with_stop_after_stops_itself(
    net: Hosts, tmp_path: Path
) -> None:
    config = system(tmp_path, "lease", h3=", on_lost: {stop_after: 1500 ms}")
    with running(net, config) as lease:
        lease.loaded()
        lease.process.kill()
        lease.process.wait()
        until(lambda: not supervisors(net, 3), "its end")
        assert supervisors(net, 2)
    with running(net, config) as heir:
        heir.loaded().stop()


@pytest.mark.parametrize("command", ["exit 7", "kill -SEGV $$"])
def test_a_failure_elsewhere_is_in_the_exit_code(net: Hosts, tmp_path: Path, command: str) -> None:
    config, ends = system(tmp_path, "codes"), tmp_path / "ends"
    waits = f"until [ -e {ends} ]; do read -t 0.05 <> <(:); done; true"
    more = f"""\
  - {{name: bad, machine: h3, command: [bash, -c, "{command}"]}}
  - {{name: last, machine: h2, on_exit: shutdown, command: [bash, -c, "{waits}"]}}
"""
    config.write_text(config.read_text() + more)
    with running(net, config) as whole:
        ended = is_(event="process", name="/bad", kind="exited")
        until(lambda: any(map(ended, whole.events())), "its end")
        ends.touch()
        assert whole.process.wait(60) == ExitCode.NODE_FAILED


def test_a_unit_that_ends_all_may_end_before_its_machine_is_heard(
    net: Hosts, tmp_path: Path
) -> None:
    config = system(tmp_path, "quick")
    over = '  - {name: over, machine: h2, on_exit: shutdown, command: ["true"]}\n'
    config.write_text(config.read_text() + over)
    with running(net, config) as whole:
        assert whole.process.wait(60) in {ExitCode.OK, ExitCode.NODES_MISSING}
