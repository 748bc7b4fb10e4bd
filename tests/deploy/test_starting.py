"""The start of several machines: what is wrong is said, and they wait for each other."""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anyio
import psutil
import pytest

from play_launch.config.machines import MachineConfig
from play_launch.deploy.machines import hosts, reach
from play_launch.deploy.machines.hosts import HostError, LinkLost, LocalHost
from play_launch.deploy.machines.namespaces import missing
from play_launch.deploy.machines.reach import reach_problems
from tests.deploy.listening import Listening, closing
from tests.support.hosts import Hosts, running, supervisors, system
from tests.support.replay import COMMAND
from tests.support.waiting import until

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.deploy.machines.hosts import Host

needs_hosts = pytest.mark.skipif(bool(missing()), reason=missing())


def report(
    *heard: str, host: str = "", shared_memory: str = "", **variables: str
) -> Mapping[str, Any]:
    return {
        "heard": heard,
        "host": host,
        "shared_memory": shared_memory,
        "variables": variables,
    }


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (report("b", host="1"), report("a", host="2"), ""),
        (report("b", host="1"), report(host="2"), ""),  # b answers to the address of a
        (report(host="1"), report(host="2"), "no multicast arrives between a and b, so"),
        (report(host="1"), report(host="2", ROS_STATIC_PEERS="a"), ""),
        (report(host="1", RMW_IMPLEMENTATION="rmw_zenoh_cpp"), report(host="2"), ""),
        (report(host="1"), report(host="2", ROS_AUTOMATIC_DISCOVERY_RANGE="OFF"), ""),
        (report("b", host="1"), report("a", host="1"), ""),
        (
            report("b", host="1", shared_memory="7"),
            report("a", host="1", shared_memory="8"),
            "a and b are one computer with two /dev/shm",
        ),
        (
            report("b", host="1", shared_memory="7"),
            report("a", host="1", shared_memory="8", FASTDDS_BUILTIN_TRANSPORTS="UDPv4"),
            "",
        ),
    ],
)
def test_what_keeps_nodes_from_finding_each_other(
    one: Mapping[str, Any], other: Mapping[str, Any], expected: str
) -> None:
    found = reach_problems({"a": one, "b": other}, multicast=True)
    assert [each[: len(expected)] for each in found] == ([expected] if expected else [])
    if "multicast" in expected:
        assert not reach_problems({"a": one, "b": other}, multicast=False)


@needs_hosts
def test_two_containers_of_one_computer_tell_that_they_are() -> None:
    asked = {"token": "", "name": "a", "others": [], "seconds": 0, "given": {"ROS_DOMAIN_ID": "x"}}
    command = [sys.executable, "-I", str(Path(reach.__file__)), json.dumps(asked)]
    apart = ["unshare", "-m", "bash", "-c", 'mount -t tmpfs tmpfs /dev/shm; exec "$@"', "bash"]
    reports = {
        name: json.loads(subprocess.run(words, capture_output=True, check=True, timeout=60).stdout)
        for name, words in (("a", command), ("b", [*apart, *command]), ("c", command))
    }
    (found,) = reach_problems(reports | {"c": {**reports["c"], "host": "2"}}, multicast=False)
    assert found.startswith("a and b are one computer")
    assert not reach_problems({"a": reports["a"], "c": reports["c"]}, multicast=False)


def test_a_command_that_is_not_waited_for_ends() -> None:
    async def stop_amid() -> list[psutil.Process]:
        with anyio.move_on_after(0.5):
            await LocalHost().run("exec sleep 100")
        return psutil.Process().children()

    assert "sleep" not in {each.name() for each in asyncio.run(stop_amid())}


def test_attempts_to_connect_grow(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[float] = []

    async def connect(machine: MachineConfig) -> Host:
        tried.append(machine.connect_timeout)
        raise LinkLost("silence") if len(tried) < 4 else HostError("a person has to act")

    monkeypatch.setattr(hosts, "connect", connect)
    monkeypatch.setattr(hosts, "_PAUSE", 0.0)
    with pytest.raises(HostError):
        asyncio.run(hosts.connect_at_first(MachineConfig(name="boots", connect_timeout=600.0)))
    assert tried == [10.0, 20.0, 40.0, 80.0]


@needs_hosts
def test_multicast_that_does_not_arrive_is_said_at_the_start(net: Hosts, tmp_path: Path) -> None:
    with running(net, system(tmp_path, "heard")) as heard:
        assert "multicast" not in heard.loaded().printed()
        heard.stop()
    net.set_multicast("off")
    try:
        with running(net, system(tmp_path, "unheard")) as unheard:
            said = unheard.loaded().printed()
            assert "no multicast arrives between main and h2, main and h3, h2 and h3, so" in said
            assert said.index("no multicast") < said.index('"container"')
            unheard.stop()
    finally:
        net.set_multicast("on")


@needs_hosts
def test_what_differs_on_a_machine_is_warned_of(net: Hosts, tmp_path: Path) -> None:
    older = tmp_path / "older"
    change = """sed 's/"version": "[^"]*"/"version": "0.0.9"/'"""
    older.write_text(
        f'#!/bin/bash\nif [ "$1" = check ]; then {COMMAND} "$@" | {change}; '
        f'else exec {COMMAND} "$@"; fi\n'
    )
    older.chmod(0o755)
    setup = tmp_path / "setup.bash"
    setup.write_text("export ROS_DOMAIN_ID=77\n")
    config = system(tmp_path, "domains", h3=f", setup: [{setup}]")
    lines = config.read_text().splitlines(keepends=True)
    text = "".join(each for each in lines if "ROS_DOMAIN_ID" not in each)
    ours = f"h3: {{service: none, play_launch: {COMMAND}"
    assert ours in text
    config.write_text(text.replace(ours, f"h3: {{service: none, play_launch: {older}"))
    with running(net, config) as domains:
        said = domains.loaded().printed()
        assert "the machines have different ROS_DOMAIN_IDs" in said
        assert "h3: its play-launch is 0.0.9, and this one " in said
        assert "h2: its play-launch" not in said
        domains.stop()


@needs_hosts
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


@needs_hosts
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


@needs_hosts
def test_the_others_start_without_an_optional_machine(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "some", h3=", optional: true, ssh: 10.77.0.99, connect_timeout: 1 s")
    with running(net, config) as some:
        assert "/listener" not in some.loaded().rows()
        assert "the others start without it" in some.printed()
        some.stop()


@needs_hosts
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


@needs_hosts
def test_peers_find_each_other_without_multicast(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "peers")
    text = config.read_text().replace("RANGE: SUBNET", "RANGE: LOCALHOST")
    config.write_text(f"{text}discovery: {{by: peers}}\n")
    with running(net, config) as peers:
        peers.loaded()
        until(lambda: "I heard" in peers.ask("logs", "listener"), "a message from the other host")
        peers.stop()


@needs_hosts
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


@needs_hosts
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
