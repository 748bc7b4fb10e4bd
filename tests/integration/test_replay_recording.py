"""A recorded system starts again, from a finished and from a cut recording."""

from __future__ import annotations

import shutil
import signal
from typing import TYPE_CHECKING

from mcap.reader import make_reader

from tests.support.replay import replaying

if TYPE_CHECKING:
    from pathlib import Path

CONFIG = """version: 1
containers:
  - name: box
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Talker
        name: talker
        parameters: [params/talker.yaml]
"""
PARAMETERS = "/talker:\n  ros__parameters: {period: 0.05}\n"


def attachments(bag: Path) -> dict[str, bytes]:
    with bag.open("rb") as file:
        return {each.name: each.data for each in make_reader(file).iter_attachments()}


def test_a_recorded_system_starts_again_without_its_files(tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    (robot / "params").mkdir(parents=True)
    (robot / "params" / "talker.yaml").write_text(PARAMETERS, encoding="utf-8")
    (robot / "robot.yaml").write_text(CONFIG, encoding="utf-8")
    with replaying(robot / "robot.yaml", tmp_path / "first") as first:
        first.read_until_states({"/talker": "loaded"})
    shutil.rmtree(robot)
    with replaying(first.bag, tmp_path / "second") as second:
        second.read_until_states({"/talker": "loaded"})
        cut = second.bag.with_name("session.mcap.active")
        kept = cut.rename(tmp_path / "kept.mcap.active")
        second.process.send_signal(signal.SIGKILL)
        second.process.wait()
    with replaying(kept, tmp_path / "third") as third:
        third.read_until_states({"/talker": "loaded"})
    then, now = attachments(first.bag), attachments(third.bag)
    for name in ("config.yaml", "parameters/0-talker.yaml", "resolved_config.json"):
        assert then[name] == now[name], name
