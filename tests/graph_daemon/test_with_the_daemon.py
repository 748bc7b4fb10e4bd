"""The thin clients with our real daemon and a real node."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from tests.support.replay import finished

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


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return finished([sys.executable, "-c", COMMAND, *arguments])


def output(*arguments: str) -> str:
    outcome = command(*arguments)
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
        stopped = command("daemon", "stop")
        process.communicate(timeout=LIMIT)
    assert stopped.returncode == 0, stopped.stderr


@pytest.mark.usefixtures("_node")
def test_the_graph_is_shown_and_the_daemon_started_for_it() -> None:
    assert command("node", "list", "--no-start").returncode == 1
    first = command("node", "list")
    assert first.returncode == 0, first.stderr
    assert "starting the graph daemon" in first.stderr

    assert first.stdout == "/thin/seen\n"
    until_shown("/thin/chatter [std_msgs/msg/String]\n", "topic", "list", "-t")
    until_shown("/thin/seen/trigger [std_srvs/srv/Trigger]\n", "service", "list", "-t")
    facts = json.loads(output("node", "info", "/thin/seen", "--json"))
    assert {"name": "/thin/chatter", "types": ["std_msgs/msg/String"]} in facts["publishers"]
    assert "/thin/seen/trigger" in [entry["name"] for entry in facts["service_servers"]]
    assert facts["action_clients"] == []
