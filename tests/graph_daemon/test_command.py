"""`play-launch daemon` and the clients of the graph, as commands with a real daemon."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from play_launch.graph_daemon.contract import LISTENING, STATUS_METHOD, DaemonAddress
from play_launch.graph_daemon.port import stop_daemon
from play_launch.graph_daemon.start_stop import start_daemon
from play_launch.graph_daemon.warm_up import LONGEST_WARM_UP
from tests.graph_daemon.occupants import end_daemons, occupied
from tests.graph_daemon.wire import ask
from tests.support.replay import finished, run

ROOT = Path(__file__).resolve().parents[2]


def command(*words: str, **environment: str) -> tuple[int, str, str]:
    """Run a verb; returns its exit code and what it wrote."""
    done = run("daemon", *words, env={**os.environ, **environment})
    return done.returncode, done.stdout, done.stderr


@pytest.fixture
def _no_client(address: DaemonAddress, logs: Path) -> Iterator[None]:
    stop_daemon(address)
    yield
    try:
        stop_daemon(address)
    finally:
        end_daemons(address.domain)


@pytest.mark.usefixtures("_no_client")
def test_a_life(address: DaemonAddress) -> None:
    domain = f"domain {address.domain}"
    assert command("status")[:2] == (1, f"no daemon runs for {domain}\n")
    assert command("stop")[:2] == (0, f"no daemon runs for {domain}\n")
    code, out, err = command("start")
    assert (code, err) == (0, "")
    assert out.startswith(f"the daemon of {domain} was started (pid ")
    code, out, _ = command("status")
    assert code == 0
    assert out.startswith(f"the daemon runs for {domain}")
    code, out, err = command("start")
    assert (code, err) == (0, "")
    assert "is running already" in out
    assert command("run")[0] == 1
    assert command("stop")[:2] == (0, f"the daemon of {domain} was stopped\n")
    assert command("status")[0] == 1


@pytest.mark.usefixtures("_no_client")
def test_the_status_for_machines_names_everything(address: DaemonAddress) -> None:
    assert json.loads(command("status", "--json")[1]) == {
        "running": False,
        "daemon": None,
        "domain": address.domain,
        "url": address.url,
        "pid": 0,
        "problem": "",
        "warnings": [],
    }
    assert command("start", "--idle-timeout", "10 min")[0] == 0
    status: dict[str, Any] = json.loads(command("status", "--json")[1])
    table = (ROOT / "docs/daemon.md").read_text().partition("| field | meaning |")[2]
    documented = set(re.findall(r"`(\w+)`", "".join(re.findall(r"(?m)^\|([^|]+)\|", table))))
    assert documented <= set(status) | {"settings"}
    assert len(documented) > 15
    assert status["running"]
    assert status["warm"]
    assert status["nodes"] == 0
    assert status["participants"] == 1
    assert status["idle_timeout"] == 600.0
    assert status["settings"]["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert status["warnings"] == []
    # Which nodes the caller's processes would discover is another matter.
    code, out, err = command("status", "--json", ROS_AUTOMATIC_DISCOVERY_RANGE="OFF")
    (warning,) = json.loads(out)["warnings"]
    assert (code, err) == (0, "")
    assert "LOCALHOST" in warning
    assert "OFF" in warning
    assert warning in command("status", ROS_AUTOMATIC_DISCOVERY_RANGE="OFF")[2]
    code, _, err = command("start", ROS_AUTOMATIC_DISCOVERY_RANGE="OFF")
    assert code == 0
    assert warning in err
    assert "--restart" in err


def test_ros2clis_daemon_is_reported_and_stopped(address: DaemonAddress) -> None:
    with occupied("stock", address.port) as process:
        code, out, _ = command("status")
        assert code == 0
        assert out == f"ros2cli's own daemon runs for domain {address.domain} (pid {process.pid})\n"
        assert json.loads(command("status", "--json")[1])["daemon"] == "ros2cli"
        for words in (["graph", "check"], ["node", "list"]):
            refused = run(*words, code=1).stderr
            assert "replace it with 'play-launch daemon start'" in refused
        assert command("stop")[1] == f"ros2cli's daemon of domain {address.domain} was stopped\n"
        assert process.wait(60) == 0


@pytest.mark.parametrize("verb", ["start", "stop", "status", "run"])
def test_a_foreign_holder_is_an_error_in_a_sentence(address: DaemonAddress, verb: str) -> None:
    with occupied("other", address.port) as process:
        code, out, err = command(verb)
        assert code == 1
        assert f"process {process.pid}" in out + err
        assert "Traceback" not in err


@pytest.mark.parametrize("verb", ["start", "stop", "status", "run"])
def test_a_domain_that_is_none_is_a_mistake_in_usage(verb: str) -> None:
    code, _, err = command(verb, ROS_DOMAIN_ID="x")
    assert code == 2
    assert "ROS_DOMAIN_ID is a number from 0 to 232" in err


PROCESSES = 6
PROGRAM = """
import sys, rclpy
rclpy.init()
node = rclpy.create_node(sys.argv[1])
print("up", flush=True)
sys.stdin.read()
rclpy.shutdown()
"""


def test_the_first_answer_names_every_node(address: DaemonAddress, logs: object) -> None:
    names = [f"early_{number}" for number in range(PROCESSES)]
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        for name in names
    ]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
    started = start_daemon(address, wait_for=LISTENING)
    try:
        seen = {name for name, _ in ask(address, "get_node_names_and_namespaces")}
        status = json.loads(ask(address, STATUS_METHOD))
        assert status["warm"]
        # A machine under such a load that discovery takes longer is not kept waiting without end.
        assert seen >= set(names) or status["age"] >= LONGEST_WARM_UP
        assert status["participants_here"] == PROCESSES + 1
    finally:
        stop_daemon(address)
        assert started.process is not None
        started.process.wait(60)
        for process in processes:
            process.communicate(timeout=60)


LIMIT = 120.0
COMMAND = "from play_launch.cli.entry import main; main()"
NODE = """
import sys
import rclpy
from std_msgs.msg import String
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("seen", namespace="/thin")
publisher = node.create_publisher(String, "chatter", 10)
service = node.create_service(Trigger, "~/trigger", lambda request, response: response)
print("up", flush=True)
sys.stdin.read()
rclpy.shutdown()
"""


def client(*arguments: str) -> subprocess.CompletedProcess[str]:
    return finished([sys.executable, "-c", COMMAND, *arguments])


def output(*arguments: str) -> str:
    outcome = client(*arguments)
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout


def until_shown(line: str, *arguments: str) -> None:
    """Ask until ``line`` is there: what a node has is discovered after the node itself."""
    deadline = time.monotonic() + LIMIT
    while line not in (shown := output(*arguments)):
        assert time.monotonic() < deadline, shown


@pytest.fixture
def _node() -> Iterator[None]:
    """A node in this test's domain; the daemon is ended together with it."""
    process = subprocess.Popen(
        [sys.executable, "-c", NODE], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        yield
    finally:
        stopped = client("daemon", "stop")
        process.communicate(timeout=LIMIT)
    assert stopped.returncode == 0, stopped.stderr


@pytest.mark.usefixtures("_node")
def test_the_graph_is_shown_and_the_daemon_started_for_it() -> None:
    assert client("node", "list", "--no-start").returncode == 1
    first = client("node", "list")
    assert first.returncode == 0, first.stderr
    assert "starting the graph daemon" in first.stderr

    assert first.stdout == "/thin/seen\n"
    until_shown("/thin/chatter [std_msgs/msg/String]\n", "topic", "list", "-t")
    until_shown("/thin/seen/trigger [std_srvs/srv/Trigger]\n", "service", "list", "-t")
    facts = json.loads(output("node", "info", "/thin/seen", "--json"))
    assert {"name": "/thin/chatter", "types": ["std_msgs/msg/String"]} in facts["publishers"]
    assert "/thin/seen/trigger" in [entry["name"] for entry in facts["service_servers"]]
    assert facts["action_clients"] == []
