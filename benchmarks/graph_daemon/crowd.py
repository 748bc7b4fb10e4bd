"""A crowd of ROS processes; also the program of each of them.

python -m benchmarks.graph_daemon.crowd INDEX NODES TOPICS
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from play_launch.ros.fastdds.shared_memory import sweep

_MADE = "made"
_START_LIMIT = 120.0
_TRANSPORT = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
"""Of the crowd alone. In a storm over shared memory with Fast DDS 2.14, nodes that want to renew a
port (``SharedMemManager::Port::regenerate_port``) wait forever for its lock, in most attempts.
The daemons choose for themselves; discovery is over UDP either way."""
ATTEMPTS = 3
"""How often a crowd is started that does not come up."""


def node_name(process: int, node: int) -> str:
    return f"p{process}_n{node}"


def main() -> None:
    """Make nodes, report for each when it was ready, and stay until the standard input ends."""
    import rclpy  # noqa: PLC0415 - the crowd's keeper needs none
    from std_msgs.msg import String  # noqa: PLC0415

    index, nodes, topics = map(int, sys.argv[1:4])
    rclpy.init()
    made = []
    for number in range(nodes):
        name = node_name(index, number)
        # A robot's nodes have parameters; their six services each are most of its topics.
        node = rclpy.create_node(name)
        for topic in range(topics):
            node.create_publisher(String, f"/{name}/t{topic}", 1)
        made.append(node)
        print(f"{_MADE} {time.time():.6f} {name}", flush=True)
    sys.stdin.read()
    rclpy.shutdown()


def shares(nodes: int, processes: int) -> list[int]:
    return [nodes // processes + (i < nodes % processes) for i in range(processes)]


class Crowd:
    """Starts all processes at once; afterwards they are gone."""

    def __init__(self, processes: int, nodes: int, topics: int) -> None:
        self._shares = shares(nodes, processes)
        self._topics = topics
        self._processes: list[subprocess.Popen[str]] = []
        self.made: dict[str, float] = {}
        """When each node was ready, as wall-clock time."""

    @property
    def names(self) -> set[str]:
        return {node_name(p, n) for p, share in enumerate(self._shares) for n in range(share)}

    def start(self) -> None:
        for index, share in enumerate(self._shares):
            self._processes.append(
                subprocess.Popen(
                    [
                        sys.executable,
                        "-m",
                        "benchmarks.graph_daemon.crowd",
                        *map(str, (index, share, self._topics)),
                    ],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    env=os.environ | _TRANSPORT,
                    text=True,
                )
            )

    def wait(self) -> bool:
        """Wait until every node is ready; returns whether they are. Else all are killed."""
        limit = threading.Timer(_START_LIMIT, self._kill)
        limit.start()
        try:
            return self._wait()
        finally:
            limit.cancel()

    def _kill(self) -> None:
        for process in self._processes:
            process.kill()

    def _wait(self) -> bool:
        for process, share in zip(self._processes, self._shares, strict=True):
            assert process.stdout is not None
            left = share
            while left:
                line = process.stdout.readline()
                if not line:
                    return False
                # Fast DDS writes its complaints here, too.
                if line.startswith(_MADE):
                    _, when, name = line.split()
                    self.made[name] = float(when)
                    left -= 1
        return True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        end_all(self._processes)
        sweep()


def end_all(processes: Sequence[subprocess.Popen[str]]) -> None:
    for process in processes:
        assert process.stdin is not None
        process.stdin.close()
    deadline = time.monotonic() + 30
    for process in processes:
        try:
            process.wait(max(0.1, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        assert process.stdout is not None
        process.stdout.close()


if __name__ == "__main__":
    main()
