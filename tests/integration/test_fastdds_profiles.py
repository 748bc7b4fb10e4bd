"""The Fast DDS profiles of fixtures/fastdds do what their comments say."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path

import pytest

from play_launch.ros.fastdds.shared_memory import SHARED_MEMORY
from tests.support.loopback_network import permitted
from tests.support.replay import replaying
from tests.support.shared_memory import segments_of

ROOT = Path(__file__).resolve().parents[2]
PROFILES = ROOT / "fixtures" / "fastdds"
MEBIBYTE = 1 << 20

# Two containers, so that what is published goes from process to process. With LOCALHOST the RMW
# makes transports of its own beside those of a profile, hence the default range, and a network of
# its own.
SYSTEM = """
version: 1
record: {{ros: false}}
environment:
  ROS_AUTOMATIC_DISCOVERY_RANGE: SUBNET
  FASTRTPS_DEFAULT_PROFILES_FILE: {profile}
containers:
  - name: sender
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Talker
        name: talker
  - name: receiver
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Listener
        name: listener
"""


@pytest.fixture
def in_a_network_of_its_own() -> None:
    if not permitted():
        pytest.skip("this kernel permits no network namespace")


@pytest.mark.usefixtures("in_a_network_of_its_own")
@pytest.mark.parametrize(("profile", "expected"), [("no_shm", []), ("large_segment", [4, 4])])
def test_profile(profile: str, expected: list[int], tmp_path: Path) -> None:
    config = tmp_path / "system.yaml"
    config.write_text(SYSTEM.format(profile=PROFILES / f"{profile}.xml"), encoding="utf-8")

    with ExitStack() as stack:
        replay = stack.enter_context(replaying(config, tmp_path / "log", in_a_network=True))
        replay.read_until(
            lambda event: "I heard" in event.get("text", ""), "a message from process to process"
        )
        # It has a /dev/shm of its own, too, which is there as long as we have it open.
        shared = os.open(f"/proc/{replay.pid}/root{SHARED_MEMORY}", os.O_RDONLY | os.O_DIRECTORY)
        try:
            found = {each.name for each in segments_of(each.pid for each in replay.descendants())}
            sizes = [os.stat(name, dir_fd=shared).st_size // MEBIBYTE for name in found]
            stack.close()
            left = found.intersection(os.listdir(shared))  # noqa: PTH208 - of a descriptor
        finally:
            os.close(shared)

    assert sizes == expected
    assert replay.process.returncode == 130
    assert not left
