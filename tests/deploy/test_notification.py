"""The protocol of sd_notify(3), over real sockets."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from play_launch.deploy.notification import claim

from .listening import Listening, closing


@pytest.fixture(params=["path", "abstract"])
def listening(request: pytest.FixtureRequest, tmp_path: Path) -> Listening:
    return Listening.in_folder(tmp_path) if request.param == "path" else Listening.abstract()


def test_what_is_said_is_heard(listening: Listening) -> None:
    environ = {"NOTIFY_SOCKET": listening.address, "WATCHDOG_USEC": "30000000", "HOME": "/x"}
    with closing(listening):
        manager = claim(environ)
        assert manager is not None
        assert manager.watchdog == 30
        assert manager.notify("READY=1", "STATUS=größer \udcff")
        assert listening.hear() == ["READY=1", "STATUS=größer ?"]
        # No other process gets it.
        assert environ == {"HOME": "/x"}
        assert claim(environ) is None


def test_the_watchdog_of_another_process_is_not_fed(listening: Listening) -> None:
    with closing(listening):
        for pid, seconds in ((os.getpid(), 0.5), (os.getpid() + 1, None)):
            environ = {
                "NOTIFY_SOCKET": listening.address,
                "WATCHDOG_USEC": "500000",
                "WATCHDOG_PID": str(pid),
            }
            manager = claim(environ)
            assert manager is not None
            assert manager.watchdog == seconds
            assert environ == {}


@pytest.mark.parametrize("value", ["", "-5", "x", "0", "1e6", "٣"])
def test_an_interval_that_is_none_is_no_watchdog(value: str) -> None:
    manager = claim({"NOTIFY_SOCKET": "/nowhere", "WATCHDOG_USEC": value})
    assert manager is not None
    assert manager.watchdog is None


@pytest.mark.parametrize("address", ["", "relative", "vsock:2:1234"])
def test_other_addresses_are_no_manager(address: str) -> None:
    environ = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}
    assert claim(environ) is None
    assert environ == {}


def test_a_manager_that_is_gone_or_does_not_read_delays_nothing(tmp_path: Path) -> None:
    listening = Listening.in_folder(tmp_path)
    with closing(listening):
        manager = claim({"NOTIFY_SOCKET": listening.address})
        assert manager is not None
        count = 0
        while manager.notify("WATCHDOG=1"):
            count += 1
            assert count < 100_000
        assert count > 0
        assert len(listening.hear_all()) == count
        assert manager.notify("WATCHDOG=1")
    assert not manager.notify("WATCHDOG=1")
