"""A system to ask about, and a daemon of ours that is asked."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from play_launch.graph_daemon.contract import DaemonAddress
from play_launch.graph_daemon.port import stop_daemon
from play_launch.graph_daemon.start_stop import start_daemon
from tests.graph_daemon.occupants import end_daemons
from tests.graph_daemon.scene import NODES
from tests.graph_daemon.wire import ask
from tests.support.waiting import until

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def address(ros_domain: int) -> DaemonAddress:
    """Where the daemon of this test process serves."""
    return DaemonAddress(ros_domain)


@pytest.fixture(scope="module", autouse=True)
def _no_daemon_is_left(address: DaemonAddress) -> Iterator[None]:
    yield
    end_daemons(address.domain)


@contextlib.contextmanager
def system(module: str) -> Iterator[None]:
    """Run the nodes of a module of this folder."""
    process = subprocess.Popen(
        [sys.executable, "-m", f"tests.graph_daemon.{module}"],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
        yield
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(60) == 0


@pytest.fixture(scope="module")
def scene() -> Iterator[None]:
    """A system of five nodes."""
    with system("scene"):
        yield


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where daemons of this module log."""
    folder = tmp_path_factory.mktemp("logs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_LOG_DIR", str(folder))
        yield folder


@pytest.fixture(scope="module")
def daemon(address: DaemonAddress, logs: Path) -> Iterator[DaemonAddress]:
    """A daemon in the background."""
    started = start_daemon(address)
    assert started.started
    assert started.process is not None
    try:
        yield address
    finally:
        stop_daemon(address)
        assert started.process.wait(60) == 0


@pytest.fixture(scope="module")
def known_scene(scene: None, daemon: DaemonAddress) -> DaemonAddress:
    """The daemon, when it knows the whole scene."""

    def is_known() -> bool:
        nodes = {tuple(node) for node in ask(daemon, "get_node_names_and_namespaces")}
        readers = ask(daemon, "count_subscribers", "/chatter")
        clients = ask(daemon, "count_clients", "/sensing/camera/reset")
        return nodes >= set(NODES) and readers == 1 and clients == 1

    until(is_known, "the whole scene")
    return daemon
