"""The overlay with the ros2cli that is installed here, whose own files stay as they are.

Runs where the command ``ros2`` is found; elsewhere each test says by name that it was not run.
"""

from __future__ import annotations

import dataclasses
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

import pytest

from play_launch.graph_daemon.contract import daemon_address
from play_launch.graph_daemon.patch import PatchError
from play_launch.graph_daemon.patch.install import overlays, plan_patch, remove
from play_launch.graph_daemon.patch.known import KNOWN
from play_launch.graph_daemon.patch.target import Target, find_target
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
    ("get_publisher_names_and_types_by_node", ("nobody", "/")),
    ("get_publishers_info_by_topic", ("/nothing",)),
    ("no_such_method", ()),
)

_UNIQUE = re.compile(r"[0-9a-f]{32}")


@pytest.fixture
def installed() -> Target:
    """The ros2cli of this machine, if it is one that can be patched."""
    try:
        target = find_target(None)
        KNOWN.check(target.folder, target.version)
    except PatchError as why:
        pytest.skip(str(why))
    return target


@pytest.fixture
def lent(installed: Target, tmp_path: Path) -> Target:
    """An environment of the same Python that finds the same packages, to be written to."""
    subprocess.run(
        [str(installed.python), "-m", "venv", "--without-pip", str(tmp_path / "lent")],
        check=True,
        timeout=LIMIT,
        env=installed.environment,
    )
    (site,) = (tmp_path / "lent").glob("lib/python3*/site-packages")
    folders = "".join(f"import site; site.addsitedir({str(s)!r})\n" for s in installed.sites)
    (site / "lent.pth").write_text(folders, encoding="utf-8")
    environment = dict(installed.environment)
    if libraries := _libraries(installed):
        # What the wheels' own .pth would find out, were it asked in their environment.
        environment["LD_LIBRARY_PATH"] = libraries
        environment["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
    return dataclasses.replace(
        installed,
        python=tmp_path / "lent" / "bin" / "python",
        environment=environment,
        sites=(site,),
        user_site=None,
    )


def _libraries(installed: Target) -> str:
    code = "import os; print(os.environ.get('LD_LIBRARY_PATH', ''))"
    return installed.run(["-c", code]).stdout.strip()


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

    def __init__(self, target: Target) -> None:
        self.address = daemon_address()
        # A stock daemon leaves its port in TIME_WAIT after some endings.
        _wait_for_the_port()
        self.process = subprocess.Popen(
            [str(target.python), "-c", START],
            env=target.environment,
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


def test_the_overlay_fits_what_is_installed(lent: Target) -> None:
    planned = plan_patch(lent)
    assert planned.place == lent.sites[0]
    planned.carry_out()


def test_a_silent_client_does_not_stop_a_patched_daemon(
    lent: Target, run_daemon: list[RealDaemon]
) -> None:
    plan_patch(lent).carry_out()
    daemon = RealDaemon(lent)
    run_daemon.append(daemon)
    where = (daemon.address.host, daemon.address.port)
    with ExitStack() as stack:
        for _ in range(50):
            stack.enter_context(socket.create_connection(where, timeout=LIMIT))
        assert daemon.call("get_namespace", ()) == "/"
    daemon.stop()


def test_the_stock_files_were_not_touched(lent: Target) -> None:
    before = {path: path.stat().st_mtime_ns for path in lent.folder.rglob("*.py")}
    plan_patch(lent).carry_out()
    assert {path: path.stat().st_mtime_ns for path in lent.folder.rglob("*.py")} == before
    assert os.fspath(lent.python) != sys.executable


def test_a_patched_daemon_answers_the_same(lent: Target, run_daemon: list[RealDaemon]) -> None:
    answers = []
    for step in ("patched", "stock"):
        if step == "patched":
            plan_patch(lent).carry_out()
        else:
            remove(lent.sites[0], overlays(lent)[0][1])
        daemon = RealDaemon(lent)
        run_daemon.append(daemon)
        # The name of the daemon's node is another each time.
        answers.append([_UNIQUE.sub("…", repr(daemon.call(*call))) for call in CALLS])
        daemon.stop()
    assert answers[0] == answers[1]
