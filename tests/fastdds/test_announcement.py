"""Our participants announce themselves often, and nobody else's do because of us."""

from __future__ import annotations

import os
import socket
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

from play_launch.fastdds.announcement import PROFILE, quick_announcement
from play_launch.fastdds.profiles import profile_in_use

PATIENCE = 60.0
VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
FASTDDS = "rmw_fastrtps_cpp"
FIRST = 6
"""Announcements that come in quick succession anyhow."""


PROGRAM = """
import sys
from play_launch.ros.thread import RosThread
ros = RosThread("announced")
ros.start()
sys.stdin.read()
ros.close()
"""
"""A process of its own: profiles are read for the first participant only."""


def seen_by_children() -> str:
    """What a program gets that is started with the C library's environment."""
    return subprocess.run(
        ["/usr/bin/env"], env=None, check=True, capture_output=True, text=True
    ).stdout


def arrivals(listener: socket.socket, count: int) -> list[float]:
    times: list[float] = []
    while len(times) < count:
        assert listener.recv(65536).startswith(b"RTPS")
        times.append(time.monotonic())
    return times


def test_a_participant_of_ours_announces_itself_often(ros_domain: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        # Where the last participant that LOCALHOST reaches would listen (RTPS 2.2, 9.6.1.1).
        listener.bind(("127.0.0.1", 7400 + 250 * ros_domain + 10 + 2 * 31))
        listener.settimeout(PATIENCE)
        with subprocess.Popen([sys.executable, "-c", PROGRAM], stdin=subprocess.PIPE) as program:
            try:
                times = arrivals(listener, FIRST + 9)
            finally:
                program.communicate(timeout=PATIENCE)
    pauses = [late - early for early, late in zip(times[FIRST:], times[FIRST + 1 :], strict=False)]
    assert statistics.median(pauses) < 1.0  # by itself it is 3 s


def test_children_do_not_get_our_profile() -> None:
    before = dict(os.environ)
    with quick_announcement(os.environ, FASTDDS):
        assert dict(os.environ) == before
        given = subprocess.run(
            ["/usr/bin/env"], env=os.environ, check=True, capture_output=True, text=True
        ).stdout
        assert VARIABLE not in given
        assert f"{VARIABLE}={PROFILE}" in seen_by_children()
    assert VARIABLE not in seen_by_children()
    assert PROFILE.is_file()


@pytest.mark.parametrize("variable", [VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE"])
def test_a_profile_of_the_user_is_left_alone(variable: str) -> None:
    with quick_announcement({variable: "/robot.xml"}, FASTDDS):
        assert str(PROFILE) not in seen_by_children()


def test_a_profile_in_the_working_directory_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text("<dds/>")
    monkeypatch.chdir(tmp_path)
    with quick_announcement({}, FASTDDS):
        assert str(PROFILE) not in seen_by_children()
    with quick_announcement({"SKIP_DEFAULT_XML_FILE": "1"}, FASTDDS):
        assert str(PROFILE) in seen_by_children()


def test_other_middlewares_get_nothing() -> None:
    with quick_announcement({}, "rmw_cyclonedds_cpp"):
        assert str(PROFILE) not in seen_by_children()


def test_it_is_said_where_a_profile_is() -> None:
    assert profile_in_use({}, ["robot.xml"]) is None
    assert profile_in_use({VARIABLE: ""}, []) is None
    assert profile_in_use({VARIABLE: "x"}, []) == f"{VARIABLE} is set"
    found = profile_in_use({}, ["DEFAULT_FASTDDS_PROFILES.xml"])
    assert found == "DEFAULT_FASTDDS_PROFILES.xml is in the working directory"
