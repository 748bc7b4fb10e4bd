"""The first answer of a daemon that has just been started is complete."""

from __future__ import annotations

import json
import subprocess
import sys

from play_launch.graph_daemon.contract import LISTENING, STATUS_METHOD, DaemonAddress
from play_launch.graph_daemon.port import stop_daemon
from play_launch.graph_daemon.start_stop import start_daemon
from play_launch.graph_daemon.warm_up import LONGEST_WARM_UP
from tests.graph_daemon.wire import ask

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
        # A machine under such a load that discovery takes longer is not kept waiting for ever.
        assert seen >= set(names) or status["age"] >= LONGEST_WARM_UP
        assert status["participants_here"] == PROCESSES + 1
    finally:
        stop_daemon(address)
        assert started.process is not None
        started.process.wait(60)
        for process in processes:
            process.communicate(timeout=60)
