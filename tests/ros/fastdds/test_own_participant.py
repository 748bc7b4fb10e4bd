"""Our participants discover others early, over UDP; the environment of children is unchanged."""

from __future__ import annotations

import os
import re
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rclpy.utilities import get_rmw_implementation_identifier

from play_launch.ros.fastdds.middleware import profile_in_use
from play_launch.ros.fastdds.own_participant import as_our_own, decide
from tests.support.loopback_network import permitted, wrapped
from tests.support.replay import finished, replaying
from tests.support.scenes import container, node, written

TIMEOUT = 60.0
FAST_DDS_3 = Path(sys.prefix, "lib", "libfastdds.so").exists()
VARIABLE = f"{'FASTDDS' if FAST_DDS_3 else 'FASTRTPS'}_DEFAULT_PROFILES_FILE"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
FASTDDS = "rmw_fastrtps_cpp"
FIRST = 6
"""Announcements that come in quick succession anyhow."""


PROGRAM = """
import sys
from play_launch.ros.thread import RosThread
ros = RosThread("announced")
ros.start()
sys.stdin.read()
ros.close()
"""
"""A process of its own: profiles are read for the first participant only."""


def seen_by_children() -> str:
    """What a program gets that is started with the C library's environment."""
    return finished(["/usr/bin/env"], code=0, env=None).stdout


def arrivals(listener: socket.socket, count: int) -> list[float]:
    times: list[float] = []
    while len(times) < count:
        assert listener.recv(65536).startswith(b"RTPS")
        times.append(time.monotonic())
    return times


def test_a_participant_of_ours_announces_itself_often(ros_domain: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        # Where the last of the 63 participants would listen (RTPS 2.2, 9.6.1.1).
        listener.bind(("127.0.0.1", 7400 + 250 * ros_domain + 10 + 2 * 62))
        listener.settimeout(TIMEOUT)
        with subprocess.Popen([sys.executable, "-c", PROGRAM], stdin=subprocess.PIPE) as program:
            try:
                times = arrivals(listener, FIRST + 9)
            finally:
                program.communicate(timeout=TIMEOUT)
    pauses = [late - early for early, late in zip(times[FIRST:], times[FIRST + 1 :], strict=False)]
    assert statistics.median(pauses) < 1.0  # its default is 3 s


MEETING = """
import asyncio, os, re, socket, subprocess, sys
first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"]) + 10
taken = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(int(sys.argv[1]))]
for number, each in enumerate(taken):
    each.bind(("127.0.0.1", first + 2 * number))
other = subprocess.Popen(
    [sys.executable, "-c", '''
import rclpy, sys
rclpy.init()
node = rclpy.create_node("plain")
print("is there", flush=True)
sys.stdin.read()
'''],
    stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
)
while "is there" not in (line := other.stdout.readline()):
    assert line
from play_launch.ros.thread import RosThread

async def main():
    ros = RosThread("ours")
    await asyncio.to_thread(ros.start)
    async with asyncio.timeout(60):
        while "plain" not in await ros.call(lambda node: node.get_node_names()):
            await asyncio.sleep(0.02)
    queues = re.search("fast(rtps|dds)_port", open("/proc/self/maps").read())
    await asyncio.to_thread(ros.close)
    print("met", "in shared memory" if queues else "over UDP", flush=True)

asyncio.run(main())
other.stdin.close()
other.wait()
"""


def met(reach: str, *, taken: int = 0, network: bool = False) -> list[str]:
    """Discover a node that exists already; so many ports of participants are taken before it."""
    command = [sys.executable, "-c", MEETING, str(taken)]
    done = subprocess.run(
        wrapped(*command) if network else command,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        timeout=6 * TIMEOUT,
        env=os.environ | {RANGE: reach},
    )
    return [line for line in done.stdout.splitlines() if line.startswith("met")]


@pytest.mark.parametrize("taken", [0, 60])
def test_an_existing_node_is_discovered_on_this_machine(taken: int) -> None:
    """Also on a port behind the 32 that rmw_fastrtps announces to."""
    assert met("LOCALHOST", taken=taken) == ["met over UDP"]


def test_the_last_domain_has_ports_enough() -> None:
    """Also for a second participant: the profile is that of the first one."""
    program = """
from play_launch.ros.thread import RosThread
for domain in (0, 232):
    ros = RosThread("ours", domain_id=domain)
    ros.start()
    ros.close()
"""
    environment = os.environ | {RANGE: "LOCALHOST"}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment, timeout=TIMEOUT)


SILENT = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <participant profile_name="silent" is_default_profile="true">
      <rtps>
        <builtin>
          <discovery_config>
            <initialAnnouncements><count>0</count></initialAnnouncements>
            <leaseDuration><sec>7200</sec></leaseDuration>
            <leaseAnnouncement><sec>3600</sec></leaseAnnouncement>
          </discovery_config>
        </builtin>
      </rtps>
    </participant>
  </profiles>
</dds>
"""
"""A participant that announces itself when it is made, and answers announcements of others."""
SILENT_NODES = """
import select, sys
from std_msgs.msg import String
from tests.support.ros import Node, begin
contexts = [begin() for _ in range(8)]
nodes = [Node(f"silent_{number}", context=each) for number, each in enumerate(contexts)]
publishers = [node.create_publisher(String, f"/{node.get_name()}", 10) for node in nodes]
print("up", flush=True)
while not select.select([sys.stdin], [], [], 0.1)[0]:
    for each in publishers:
        each.publish(String(data="here"))
for node, context in zip(nodes, contexts):
    node.destroy_node()
    context.try_shutdown()
"""
ANSWERS = """
import asyncio
from play_launch.ros.thread import RosThread
async def meet():
    ros = RosThread("meets")
    ros.begin()
    async with asyncio.timeout(20):
        await ros.until(lambda node: sum("silent" in name for name in node.get_node_names()) == 8)
    ros.close()
asyncio.run(meet())
"""


@contextmanager
def silent_nodes(tmp_path: Path) -> Iterator[None]:
    """Nodes that announce themselves only in answers; else that takes 3 s, and here an hour."""
    profile = tmp_path / "silent.xml"
    profile.write_text(SILENT)
    there = [sys.executable, "-c", SILENT_NODES]
    environment = os.environ | {VARIABLE: str(profile)}
    with subprocess.Popen(
        there, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == b"up\n"
        try:
            yield
        finally:
            program.communicate(timeout=TIMEOUT)


def test_what_exists_already_is_discovered_by_its_answers_alone(tmp_path: Path) -> None:
    with silent_nodes(tmp_path):
        for _ in range(3):
            subprocess.run([sys.executable, "-c", ANSWERS], check=True, timeout=TIMEOUT)


@pytest.mark.parametrize("mode", ["standard", "isolated"])
def test_so_is_what_a_restarted_container_hears(tmp_path: Path, mode: str) -> None:
    listeners = [
        node(f"listener_{number}", "Listener", remappings={"chatter": f"/silent_{number}"})
        for number in range(8)
    ]
    loading = {"container_type": mode}
    containers = [container("late", *listeners)]
    config = written(tmp_path, composable_node_loading=loading, containers=containers)
    with silent_nodes(tmp_path), replaying(config, tmp_path / "logs") as system:
        pid = system.read_until_up("/late")["/late"]["pid"]
        for _ in range(2):
            heard: set[str] = set()
            while len(heard) < len(listeners):
                line = system.until(event="output")["text"]
                heard |= set(re.findall(r"\[(listener_\d)\]: I heard 'here'", line))
            os.kill(pid, signal.SIGKILL)
            pid = system.until(event="process", kind="started", name="/late")["pid"]


@pytest.mark.skipif(not permitted(), reason="this kernel permits no network namespace")
def test_an_existing_node_is_discovered_by_multicast() -> None:
    assert met("SUBNET", network=True) == ["met over UDP"]


@pytest.mark.parametrize("reach", ["LOCALHOST", "SUBNET"])
def test_children_do_not_get_what_is_ours(reach: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RANGE, reach)
    before = dict(os.environ)
    assert get_rmw_implementation_identifier() == FASTDDS  # and is loaded, as it is where we use it
    with as_our_own(os.environ, FASTDDS):
        assert dict(os.environ) == before
        given = finished(["/usr/bin/env"], code=0, env=os.environ).stdout
        assert VARIABLE not in given
        assert f"{RANGE}={reach}" in given
        ours = dict(line.partition("=")[::2] for line in seen_by_children().splitlines())
        profile = Path(ours[VARIABLE]).read_text(encoding="ascii")
        assert ("initialPeersList" in profile) == (reach == "LOCALHOST")
        assert ours[RANGE] == ("SYSTEM_DEFAULT" if reach == "LOCALHOST" else reach)
    after = seen_by_children()
    assert VARIABLE not in after
    assert f"{RANGE}={reach}" in after
    assert not Path(ours[VARIABLE]).exists()


@pytest.mark.parametrize(
    ("environment", "files", "transports", "own"),
    [
        ({"HOME": "/"}, ["robot.yaml"], "UDPv4", (True, False)),
        ({RANGE: "SUBNET"}, [], "UDPv4", (True, False)),
        ({RANGE: "LOCALHOST"}, [], "UDPv4", (True, True)),
        ({"ROS_LOCALHOST_ONLY": "1"}, [], "UDPv4", (True, True)),
        # The peers are configured.
        ({RANGE: "OFF"}, [], "", (False, False)),
        ({RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.1"}, [], "", (False, False)),
        ({"ROS_STATIC_PEERS": "10.0.0.1"}, [], "", (False, False)),
        # The transports are.
        ({"FASTDDS_BUILTIN_TRANSPORTS": "SHM"}, [], "SHM", (False, False)),
        ({"FASTDDS_BUILTIN_TRANSPORTS": ""}, [], "", (False, False)),
        ({"SKIP_DEFAULT_XML_FILE": "1"}, ["DEFAULT_FASTDDS_PROFILES.xml"], "UDPv4", (True, False)),
    ],
)  # fmt: skip
def test_what_is_chosen(
    environment: dict[str, str], files: list[str], transports: str, own: tuple[bool, bool]
) -> None:
    chosen = decide(environment, files, FASTDDS)
    assert chosen is not None
    assert (chosen.profile, chosen.transports) == (True, transports)
    assert (chosen.own_transport, chosen.on_loopback) == own


@pytest.mark.parametrize(
    ("environment", "files"),
    [
        ({VARIABLE: "profile.xml"}, []),
        ({"FASTDDS_DEFAULT_PROFILES_FILE": "profile.xml"}, []),
        ({}, ["DEFAULT_FASTRTPS_PROFILES.xml"]),
        ({}, ["DEFAULT_FASTDDS_PROFILES.xml"]),
    ],
)
def test_a_profile_of_the_user_is_left_alone(
    environment: dict[str, str], files: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in files:
        (tmp_path / name).write_text("<dds/>")
    monkeypatch.chdir(tmp_path)
    with as_our_own(environment, FASTDDS) as chosen:
        assert chosen is not None
        assert not chosen.profile
        assert chosen.reason.split(" ", 1)[0] in {*environment, *files}
        assert VARIABLE not in seen_by_children()


def test_other_middlewares_get_nothing() -> None:
    with as_our_own({}, "rmw_cyclonedds_cpp") as chosen:
        assert chosen is None
        assert VARIABLE not in seen_by_children()


def test_it_is_said_where_a_profile_is() -> None:
    assert profile_in_use({}, ["robot.xml"]) is None
    assert profile_in_use({VARIABLE: ""}, []) is None
    assert profile_in_use({VARIABLE: "x"}, []) == f"{VARIABLE} is set"
    found = profile_in_use({}, ["DEFAULT_FASTDDS_PROFILES.xml"])
    assert found == "DEFAULT_FASTDDS_PROFILES.xml is in the working directory"
