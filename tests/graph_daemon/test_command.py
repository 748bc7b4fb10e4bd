"""`play-launch daemon start | status | stop`, as commands."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from play_launch.cli.daemon import describe
from play_launch.graph_daemon.contract import DaemonAddress
from play_launch.graph_daemon.port import OwnerKind, PortOwner, stop_daemon
from tests.graph_daemon.occupants import end_daemons, occupied
from tests.support.replay import run

ROOT = Path(__file__).resolve().parents[2]
COMMAND = Path(sys.executable).parent / "play-launch"


def command(*words: str, **environment: str) -> tuple[int, str, str]:
    """Run a verb; returns its exit code and what it wrote."""
    done = run("daemon", *words, env={**os.environ, **environment})
    return done.returncode, done.stdout, done.stderr


@pytest.fixture
def _nobody(address: DaemonAddress, logs: Path) -> Iterator[None]:
    stop_daemon(address)
    yield
    try:
        stop_daemon(address)
    finally:
        end_daemons(address.domain)


@pytest.mark.usefixtures("_nobody")
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


@pytest.mark.usefixtures("_nobody")
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
    # Whom the caller's processes would meet is another matter.
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


def test_a_time_that_is_none_is_a_mistake_in_usage() -> None:
    code, _, err = command("start", "--idle-timeout", "soon")
    assert code == 2
    assert "--idle-timeout" in err


@pytest.mark.parametrize("kind", list(OwnerKind))
def test_every_owner_is_described(kind: OwnerKind) -> None:
    owner = PortOwner(kind, 7, "nc -l", problem="it is silent")
    (first, *_) = describe(DaemonAddress(3), owner)
    assert "domain 3" in first
    if kind is not OwnerKind.FREE:
        assert "7" in first
