"""Sessions of before are looked after by a real run, when its own system is up."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from play_launch.postmortem import upkeep
from play_launch.postmortem.bag_reader import BagReader
from tests.postmortem.archive.scenes import begin_session, cut_off_session, name_of, past_session
from tests.support.replay import replaying

if TYPE_CHECKING:
    from pathlib import Path

AT_ONCE = (
    sys.executable,
    "-c",
    (
        "from play_launch.cli import entry\n"
        "from play_launch.postmortem import upkeep\n"
        "upkeep.REST = 0.0; entry.main()"
    ),
)
"""The command, as installed, but for the rest between the bring-up and the first look."""
CONFIG = """version: 1
record: {{ros: false, keep: {keep}}}
nodes: [{{name: idle, command: [sleep, "300"]}}]
"""


def configuration(folder: Path, keep: str) -> Path:
    file = folder / "robot.yaml"
    file.write_text(CONFIG.format(keep=keep), encoding="utf-8")
    return file


def about(word: str) -> Any:
    def wanted(event: dict[str, Any]) -> bool:
        is_ours = event["event"] == "log" and event["name"] == upkeep.__name__
        return is_ours and str(event["message"]).startswith(word)

    return wanted


def test_a_run_keeps_to_its_limits_and_completes_what_was_cut_off(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    for day in (1, 2, 4):
        past_session(logs, day)
    pinned = past_session(logs, 3)
    (pinned / "note.txt").write_text("look at this one", encoding="utf-8")
    cut_off = cut_off_session(logs, 5)
    running, writer = begin_session(logs, 6)
    with replaying(configuration(tmp_path, "{sessions: 3}"), logs, program=AT_ONCE) as replay:
        removed = replay.read_until(about("removed "), "that something is removed")
        recovered = replay.read_until(about("recovered "), "that something is completed")
        kept = {path.name for path in logs.iterdir()}
        assert replay.process.poll() is None
    writer.close()
    assert removed["message"].startswith("removed 3 sessions")
    assert "the latest of them 2026-11-04" in removed["message"]
    own = (logs / "latest").resolve().name
    # Three count: the run's own, the other one that runs, and the latest of the rest.
    assert kept == {pinned.name, cut_off.name, running.name, own, "latest", ".order"}
    assert "recovered the recording of 1 session" in recovered["message"]
    assert name_of(5) in recovered["message"]
    reader = BagReader(cut_off / "session.mcap")
    assert len(list(reader.messages())) == 10
    assert reader.is_complete
    assert not (cut_off / "session.mcap.active").exists()
    # What it did is in its own recording, too.
    texts = b"".join(message.data for message in BagReader(replay.bag).messages())
    assert b"removed 3 sessions" in texts


def test_a_run_without_limits_removes_nothing(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    for day in (1, 2):
        past_session(logs, day)
    cut_off_session(logs, 3)
    with replaying(configuration(tmp_path, "{}"), logs, program=AT_ONCE) as replay:
        replay.read_until(about("recovered "), "that something is completed")
    assert {name_of(day) for day in (1, 2, 3)} < {path.name for path in logs.iterdir()}
