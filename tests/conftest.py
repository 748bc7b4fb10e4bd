"""What every test stands on: loopback only, a domain of its own, nothing left behind."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import psutil
import pytest

from play_launch.container.ros import RosSource, ros_installation
from play_launch.ros.fastdds.shared_memory import sweep

# For `tests.…`; at the end, so that `play_launch` is the installed package.
sys.path.append(str(Path(__file__).resolve().parents[1]))

from tests.support.loopback_network import leave_shared_memory

pytest_plugins = ["tests.support.turns"]

# Those from 81 to 101 are of the tests in C++, the ports of higher ones are free for all.
DOMAINS = range(1, 81)


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


def claim_domain() -> tuple[int, socket.socket]:
    """Take a ROS domain, and with it a graph daemon's port, that no other test process has.

    Others are those of another run as well as those of this one, where pytest-xdist spreads the
    tests. The claim is an abstract unix socket: the kernel gives it back when the process ends,
    however it ends.
    """
    start = os.getpid() % len(DOMAINS)
    for domain in (*DOMAINS[start:], *DOMAINS[:start]):
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0play-launch-test-domain-{domain}")
        except OSError:
            claim.close()
            continue
        return domain, claim
    raise RuntimeError("all 80 ROS domains are taken by test processes")


def load_interfaces() -> None:
    """Load the libraries of our interfaces, which the dynamic loader then finds by their names.

    With wheels LD_LIBRARY_PATH has their folder. Beside a sourced ROS only the children of
    play-launch need it, and the tests, which use rclpy with these interfaces themselves.
    """
    ros = ros_installation()
    if ros.source is RosSource.SYSTEM:
        for library in sorted((ros.prefix / "lib").glob("lib*__rosidl_*.so")):
            ctypes.CDLL(os.fspath(library), mode=ctypes.RTLD_GLOBAL)


_DOMAIN, _CLAIM = claim_domain()
atexit.register(_CLAIM.close)
if "PYTEST_XDIST_WORKER" in os.environ:
    # Participants of all domains share some queues in /dev/shm: those that a test kills or stops
    # hold up those of the tests beside it. Where this is not permitted, that may happen.
    with contextlib.suppress(OSError):
        leave_shared_memory()
# Before anything imports rclpy, and for every process that a test starts.
os.environ["ROS_DOMAIN_ID"] = str(_DOMAIN)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.pop("ROS_LOCALHOST_ONLY", None)
# With it, no write waits for one of another thread, which hides that others do.
os.environ.pop("PYTHONUNBUFFERED", None)
load_interfaces()
# What a shell starts in the background, or nohup, ignores these, and so would all that the tests
# start.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGQUIT, signal.SIG_DFL)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# The time of an example means nothing where other tests run at the same time. The same tree is
# tried with the same examples; `--hypothesis-profile search` looks for others.
hypothesis.settings.register_profile(
    "tests",
    hypothesis.settings(),
    max_examples=50,
    deadline=None,
    derandomize=True,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.register_profile(
    "search", hypothesis.settings.get_profile("tests"), derandomize=False, max_examples=1000
)
hypothesis.settings.load_profile("tests")


@pytest.fixture(scope="session")
def ros_domain() -> int:
    """The ROS_DOMAIN_ID of this test process."""
    return _DOMAIN


@pytest.fixture(scope="session")
def other_domain() -> Iterator[int]:
    """A second one, which nothing else uses either."""
    domain, claim = claim_domain()
    with claim:
        yield domain


@pytest.fixture(scope="session", autouse=True)
def _nothing_is_left_behind() -> Iterator[None]:
    yield
    children = psutil.Process().children(recursive=True)
    left = [f"{child.pid} {' '.join(child.cmdline())}" for child in children if child.is_running()]
    assert not left, "processes are left: " + "; ".join(left)
    # What killed participants leave is removed by the next start, and here after the last one.
    # `support.replay` and `test_stopping` assert that an orderly end leaves nothing.
    sweep()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List by name what was skipped; pytest itself counts it by reason."""
    skipped: dict[tuple[str, str], int] = {}
    for report in terminalreporter.getreports("skipped"):
        _, _, reason = report.longrepr
        test = (report.nodeid.partition("[")[0], reason.removeprefix("Skipped: "))
        skipped[test] = skipped.get(test, 0) + 1
    if skipped:
        terminalreporter.section("not run")
    for (name, reason), count in skipped.items():
        times = f" ({count} cases)" if count > 1 else ""
        terminalreporter.line(f"{name}{times}: {reason}")
