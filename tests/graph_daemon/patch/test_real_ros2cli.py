"""The overlay with a real ros2cli, where one is installed or in PYTHONPATH."""

from __future__ import annotations

import importlib.util
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from site import getsitepackages
from typing import Any
from xmlrpc.client import ServerProxy

import pytest

from play_launch.graph_daemon.contract import daemon_address
from play_launch.graph_daemon.patch import remove, write
from tests.graph_daemon.patch.conftest import LIMIT

START = """
from ros2cli.daemon import main
import os, rclpy
main(argv=["--ros-domain-id", os.environ["ROS_DOMAIN_ID"],
           "--rmw-implementation", rclpy.get_rmw_implementation_identifier()])
"""
CALLS: tuple[tuple[str, tuple[Any, ...]], ...] = (
    ("system.listMethods", ()),
    ("system.methodHelp", ("get_topic_names_and_types",)),
    ("system.methodSignature", ("get_node_names_and_namespaces",)),
    ("get_namespace", ()),
    ("get_topic_names_and_types", ()),
    ("get_topic_names_and_types", (True,)),
    ("get_service_names_and_types", ()),
    ("get_action_names_and_types", ()),
    ("count_publishers", ("/rosout",)),
    ("count_subscribers", ("/rosout",)),
    ("get_publisher_names_and_types_by_node", ("absent", "/")),
    ("get_publishers_info_by_topic", ("/nothing",)),
    ("no_such_method", ()),
)

_UNIQUE = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True)
class Lent:
    """A virtual environment that finds the packages of this one, and the ros2cli of PYTHONPATH."""

    python: Path
    site: Path


@pytest.fixture
def lent(tmp_path: Path) -> Lent:
    if importlib.util.find_spec("ros2cli") is None:
        pytest.skip("there is no ros2cli here; add it to PYTHONPATH")
    root = tmp_path / "lent"
    venv = [sys.executable, "-m", "venv", "--without-pip", str(root)]
    subprocess.run(venv, check=True, timeout=LIMIT)
    (site,) = root.glob("lib/python3*/site-packages")
    folders = "".join(f"import site; site.addsitedir({s!r})\n" for s in getsitepackages())
    (site / "lent.pth").write_text(folders, encoding="utf-8")
    return Lent(root / "bin" / "python", site)


def _wait_for_the_port() -> None:
    address = daemon_address()
    deadline = time.monotonic() + 2 * LIMIT
    while True:
        with socket.socket() as listener:
            try:
                listener.bind((address.host, address.port))
            except OSError:
                assert time.monotonic() < deadline
                time.sleep(0.2)
            else:
                return


class RealDaemon:
    """ros2cli's own daemon in this test's domain."""

    def __init__(self, target: Lent) -> None:
        self.address = daemon_address()
        # A stock daemon leaves its port in TIME_WAIT after some endings.
        _wait_for_the_port()
        self.process = subprocess.Popen(
            [str(target.python), "-c", START],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd="/",
        )
        deadline = time.monotonic() + LIMIT
        while True:
            try:
                self.call("get_namespace", ())
            except OSError:
                assert self.process.poll() is None, "the daemon has ended"
                assert time.monotonic() < deadline
                time.sleep(0.05)  # There is no event for that a port is listened on.
            else:
                return

    def call(self, method: str, arguments: tuple[Any, ...]) -> Any:
        with ServerProxy(self.address.url, allow_none=True) as proxy:
            try:
                return getattr(proxy, method)(*arguments)
            except Exception as error:
                if isinstance(error, OSError):
                    raise
                return repr(error)

    def stop(self) -> None:
        try:
            self.call("system.shutdown", ())
            assert self.process.wait(LIMIT) == 0
        finally:
            self.process.kill()
            self.process.wait(LIMIT)


@pytest.fixture
def run_daemon() -> Iterator[list[RealDaemon]]:
    daemons: list[RealDaemon] = []
    yield daemons
    for daemon in daemons:
        if daemon.process.poll() is None:
            daemon.stop()


def test_a_silent_client_does_not_stop_a_patched_daemon(
    lent: Lent, run_daemon: list[RealDaemon]
) -> None:
    write(lent.site)
    daemon = RealDaemon(lent)
    run_daemon.append(daemon)
    where = (daemon.address.host, daemon.address.port)
    with ExitStack() as stack:
        for _ in range(50):
            stack.enter_context(socket.create_connection(where, timeout=LIMIT))
        assert daemon.call("get_namespace", ()) == "/"
    daemon.stop()


def test_a_patched_daemon_answers_the_same(lent: Lent, run_daemon: list[RealDaemon]) -> None:
    answers = []
    for step in ("patched", "stock"):
        if step == "patched":
            write(lent.site)
        else:
            remove(lent.site)
        daemon = RealDaemon(lent)
        run_daemon.append(daemon)
        # The name of the daemon's node is another each time.
        answers.append([_UNIQUE.sub("…", repr(daemon.call(*call))) for call in CALLS])
        daemon.stop()
    assert answers[0] == answers[1]
