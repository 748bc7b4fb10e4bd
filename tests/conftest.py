"""What every test stands on: loopback only, a domain of its own, nothing left behind."""

from __future__ import annotations

import atexit
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from play_launch.fastdds.shared_memory import sweep

# For `tests.…`; at the end, so that `play_launch` is the installed package.
sys.path.append(str(Path(__file__).resolve().parents[1]))

DOMAINS = range(1, 101)
SHARED_MEMORY = Path("/dev/shm")


def claim_domain() -> tuple[int, socket.socket]:
    """Take a ROS domain that no other test process of this machine has.

    The claim is an abstract unix socket: the kernel gives it back when the process ends, however
    it ends.
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
    raise RuntimeError("all 100 ROS domains are taken by test processes")


_DOMAIN, _CLAIM = claim_domain()
atexit.register(_CLAIM.close)
# Before anything imports rclpy, and for every process that a test starts.
os.environ["ROS_DOMAIN_ID"] = str(_DOMAIN)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.pop("ROS_LOCALHOST_ONLY", None)


def segments() -> set[str]:
    return {path.name for path in SHARED_MEMORY.glob("*fastrtps*")}


@pytest.fixture(scope="session")
def ros_domain() -> int:
    """The ROS_DOMAIN_ID of this test process."""
    return _DOMAIN


@pytest.fixture(scope="session", autouse=True)
def _nothing_is_left_behind() -> Iterator[None]:
    before = segments()
    yield
    children = psutil.Process().children(recursive=True)
    left = [f"{child.pid} {' '.join(child.cmdline())}" for child in children if child.is_running()]
    assert not left, "processes are left: " + "; ".join(left)
    # Other programs of this machine may use DDS; a segment is left behind if its owner is dead.
    orphans = set(sweep().removed) - before
    assert not orphans, f"Fast DDS segments were left behind: {sorted(orphans)}"
