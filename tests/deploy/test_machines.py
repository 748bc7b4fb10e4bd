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

from play_launch.deploy.machines.namespaces import missing
from tests.deploy.listening import Listening, closing
from tests.support.hosts import Hosts, running, supervisors, system
from tests.support.replay import COMMAND
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


def test_a_stop_amid_the_start_leaves_nothing(net: Hosts, tmp_path: Path) -> None:
    with running(net, system(tmp_path, "earliest")) as earliest:
        begun = net.home / ".ros/play_launch"
        until(lambda: any(begun.glob("*-earliest")), "its recording")
        earliest.process.send_signal(signal.SIGINT)
        assert earliest.process.wait(40) in {0, 3, 130}, earliest.printed()
    assert not supervisors(net, 2)
    for word in ("h2", "h3"):
        with running(net, system(tmp_path, f"early_{word}")) as early:
            until(lambda: f'"machine":"{word}"' in early.printed(), "the first event")  # noqa: B023
            early.process.send_signal(signal.SIGINT)
            assert early.process.wait(40) in {1, 3, 130}, early.printed()
        assert not supervisors(net, 2)
        assert not supervisors(net, 3)


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


def test_a_full_disk_of_a_machine_is_said_before_anything_starts(
    net: Hosts, tmp_path: Path
) -> None:
    (tmp_path / "map").write_bytes(bytes(1_000_000))
    cache = net.folder / "home3/.cache"
    cache.mkdir(exist_ok=True)
    mount = ("mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(cache))
    subprocess.run(net.command(*mount, host=3), check=True)
    try:
        config = system(tmp_path, "full", h3=", copy: [map]")
        done = net.run("replay", str(config))
    finally:
        subprocess.run(net.command("umount", "-l", str(cache), host=3), check=True)
    assert done.returncode == 1
    assert "machine h3: files cannot be written there: " in done.stderr
    assert not supervisors(net, 2)


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


def test_the_others_start_without_an_optional_machine(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "some", h3=", optional: true, ssh: 10.77.0.99, connect_timeout: 1 s")
    with running(net, config) as some:
        assert "/listener" not in some.loaded().rows()
        assert "the others start without it" in some.printed()
        some.stop()


def test_an_optional_machine_joins_when_it_answers(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "joins", h3=", optional: true, connect_timeout: 1 s")
    net.set_link(3, "down")
    try:
        with running(net, config) as joins:
            assert "/listener" not in joins.loaded().rows()
            net.set_link(3, "up")
            until(lambda: "/listener" in joins.rows(), "the machine")
            assert joins.loaded().rows()["/listener"]["machine"] == "h3"
            assert "h3: it answers by now, and is started" in joins.printed()
            joins.stop()
    finally:
        net.set_link(3, "up")


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


def test_peers_find_each_other_without_multicast(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "peers")
    text = config.read_text().replace("RANGE: SUBNET", "RANGE: LOCALHOST")
    config.write_text(f"{text}discovery: {{by: peers}}\n")
    with running(net, config) as peers:
        peers.loaded()
        until(lambda: "I heard" in peers.ask("logs", "listener"), "a message from the other host")
        peers.stop()


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


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"h3: {": "h3: {ssh: 10.77.0.99, connect_timeout: 1 s, "}, "it does not answer"),
        ({f"h3: {{service: none, play_launch: {COMMAND}": "h3: {play_launch: OLD"}, "protocol 1"),
        (
            {f"h3: {{service: none, play_launch: {COMMAND}": "h3: {play_launch: /x"},
            "as play_launch",
        ),
        ({"h3: {": "h3: {ssh: nowhere.invalid, "}, "is not known"),
        ({"h3: {": "h3: {ssh: stranger@h3, "}, "does not let you in"),
        ({"h3: {": "h3: {ssh: unknown_key, "}, "host key is unknown"),
        (
            {"lost_after: 1 s}\ncontainers": "setup: [/no/such/setup.bash]}\ncontainers"},
            "setup.bash",
        ),
        ({"lost_after: 1 s}\ncontainers": "copy: [nothing]}\ncontainers"}, "/nothing"),
    ],
)
def test_what_is_wrong_with_a_machine_is_said_before_anything_starts(
    net: Hosts, tmp_path: Path, changes: dict[str, str], expected: str
) -> None:
    aliases = net.home / ".ssh/config"
    if "unknown_key" not in aliases.read_text():
        alias = "Host unknown_key\n  HostName 10.77.0.3\n  UserKnownHostsFile /dev/null\n"
        aliases.write_text(aliases.read_text() + alias)
    old = tmp_path / "old"
    old.write_text("""#!/bin/sh\necho '{"valid": true, "protocol": 1}'\n""")
    old.chmod(0o755)
    config = system(tmp_path, "wrong")
    text = config.read_text()
    for before, after in changes.items():
        assert before in text
        text = text.replace(before, after.replace("OLD", str(old)))
    config.write_text(text)
    done = net.run("replay", str(config))
    assert done.returncode == 1, done.stdout + done.stderr
    assert "nothing was started\n" in done.stderr
    assert "machine h3: " in done.stderr
    assert expected in done.stderr
    assert not supervisors(net, 2)


def test_a_service_is_up_when_all_machines_are(
    net: Hosts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = system(tmp_path, "serves", h3=", connect_timeout: 40 s")
    net.set_link(3, "down")
    with closing(Listening.in_folder(tmp_path)) as manager:
        monkeypatch.setenv("NOTIFY_SOCKET", manager.address)
        monkeypatch.setenv("WATCHDOG_USEC", "3000000")
        started = running(net, config)
        with started as serves:
            # A machine that is booted later is waited for.
            until(lambda: "h3: it does not answer" in serves.printed(), "the first attempt")
            assert "READY=1" not in manager.hear_all()
            net.set_link(3, "up")
            manager.until("READY=1")
            assert "WATCHDOG=1" in manager.said
            assert serves.rows()["/listener"]["state"] == "loaded"
            with config.open("a") as file:
                file.write("  - {name: late, command: [sleep, '1000'], start_delay: 1 s}\n")
            serves.ask("apply", str(config))
            manager.until("RELOADING=1")
            manager.until("READY=1")
            manager.until("STATUS=3 of 3 machines running, 7 of 7 up")
            serves.stop()
        assert "STOPPING=1" in manager.hear_all() + manager.said
    assert not supervisors(net, 3)
