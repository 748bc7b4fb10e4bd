"""What was cut off is completed, once, whichever process is killed meanwhile."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import pytest
from rosbags.highlevel import AnyReader

from play_launch.postmortem.archive import complete_session
from play_launch.postmortem.bag_reader import BagReader
from play_launch.recording.bag import BagWriter
from play_launch.recording.session import announce, create_session_folder
from tests.postmortem.archive.scenes import begin_session, cut_off_session, name_of, past_session
from tests.recording.reading import messages
from tests.support.mounts import mounted

if TYPE_CHECKING:
    from pathlib import Path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_it_becomes_a_whole_one(tmp_path: Path) -> None:
    folder = cut_off_session(tmp_path, 1, lines=20)
    stamp = 1_000_000_000
    os.utime(folder / "session.mcap.active", ns=(stamp, stamp))
    (completed,) = complete_session(folder)
    assert (completed.path, completed.messages) == (folder / "session.mcap", 20)
    assert not completed.has_gaps
    assert names(folder) == ["metadata.yaml", "session.mcap"]
    assert completed.path.stat().st_mtime_ns == stamp, "it is as old as before"
    assert len(messages(completed.path)) == 20
    assert complete_session(folder) == []


def test_of_several_files_the_last_one_and_the_index(tmp_path: Path) -> None:
    folder = cut_off_session(tmp_path, 1, parts=3)
    assert names(folder) == [
        "metadata.yaml",
        "session.mcap",
        "session_1.mcap",
        "session_2.mcap.active",
    ]
    (completed,) = complete_session(folder)
    assert completed.path.name == "session_2.mcap"
    reader = BagReader(folder)
    assert sum(1 for _ in reader.messages()) == 20
    assert (reader.damages, reader.is_complete) == ([], True)
    with AnyReader([folder]) as others:
        assert others.message_count == 20


def test_a_running_one_is_left_alone(tmp_path: Path) -> None:
    folder, writer = begin_session(tmp_path, 1)
    writer.flush()
    assert complete_session(folder) == []
    assert names(folder) == ["session.mcap.active"]
    writer.close()
    assert len(messages(folder / "session.mcap")) == 10


@pytest.mark.parametrize("cut", [1, 40, 200])
def test_a_torn_end_is_no_gap(tmp_path: Path, cut: int) -> None:
    folder = cut_off_session(tmp_path, 1)
    active = folder / "session.mcap.active"
    os.truncate(active, active.stat().st_size - cut)
    (completed,) = complete_session(folder)
    assert not completed.has_gaps
    assert names(folder) == ["metadata.yaml", "session.mcap"]


def test_what_is_damaged_within_is_kept_beside(tmp_path: Path) -> None:
    folder, writer = begin_session(tmp_path, 1)
    writer.flush()
    middle = writer.bytes_written - 300
    for number in range(10):
        writer.write(1, b"\0\1\0\0", log_time=number + 50, publish_time=number)
    writer.flush()
    writer.abandon()
    active = folder / "session.mcap.active"
    data = bytearray(active.read_bytes())
    data[middle] ^= 0xFF
    active.write_bytes(data)
    (completed,) = complete_session(folder)
    assert completed.has_gaps
    assert names(folder) == ["metadata.yaml", "session.mcap", "session.mcap.damaged"]
    assert (folder / "session.mcap.damaged").read_bytes() == data
    assert complete_session(folder) == []


def test_killed_between_its_two_steps_it_takes_the_second_one(tmp_path: Path) -> None:
    folder = past_session(tmp_path, 1)
    data = (folder / "session.mcap").read_bytes()
    (folder / "session.mcap.active").write_bytes(data)
    (folder / "session.mcap.recovering").write_bytes(data[:100])
    complete_session(folder)
    assert "session.mcap.active" not in names(folder)
    assert (folder / "session.mcap").read_bytes() == data


def test_a_file_that_was_begun_and_holds_nothing_goes(tmp_path: Path) -> None:
    folder = cut_off_session(tmp_path, 1, parts=2)
    (folder / "session_2.mcap.active").touch()
    reader = BagReader(folder)
    assert sum(1 for _ in reader.messages()) == 10
    assert reader.files == ("session.mcap", "session_1.mcap.active")
    complete_session(folder)
    assert names(folder) == ["metadata.yaml", "session.mcap", "session_1.mcap"]
    begun = tmp_path / name_of(2)
    begun.mkdir()
    (begun / "session.mcap.active").touch()
    assert complete_session(begun) == []
    assert names(begun) == []


def archive(log_folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "play_launch.postmortem.archive", str(log_folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_program_keeps_completes_and_says_so_in_two_lines(tmp_path: Path) -> None:
    for day in range(1, 5):
        past_session(tmp_path, day)
    cut_off_session(tmp_path, 5, lines=7)
    _, writer = begin_session(tmp_path, 6)
    done = archive(tmp_path, "--keep-sessions=3")
    assert (done.returncode, done.stderr) == (0, "")
    removed, recovered = done.stdout.splitlines()
    assert removed.startswith("info: removed 3 sessions (")
    assert removed.endswith(f"the latest of them {name_of(3)}")
    assert recovered == (
        "warning: recovered the recording of 1 session that did not end in order (7 messages): "
        f"{name_of(5)}"
    )
    assert names(tmp_path) == [name_of(4), name_of(5), name_of(6)]
    assert names(tmp_path / name_of(5)) == ["metadata.yaml", "session.mcap"]
    again = archive(tmp_path, "--keep-sessions=3")
    assert (again.returncode, again.stdout, again.stderr) == (0, "", "")
    writer.close()


def test_what_cannot_be_removed_or_completed_keeps_nothing_else(tmp_path: Path) -> None:
    for day in range(1, 5):
        past_session(tmp_path, day)
    for day in (5, 6):
        cut_off_session(tmp_path, day)
    # What is a mount point cannot be removed.
    stuck = [tmp_path / name_of(1) / "session.mcap", tmp_path / name_of(5) / "session.mcap.active"]
    mount = " && ".join(f"mount --bind {each} {each}" for each in stuck)
    archived = [
        sys.executable,
        "-m",
        "play_launch.postmortem.archive",
        tmp_path,
        "--keep-sessions=3",
    ]
    done = subprocess.run(mounted(mount, *archived), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "")
    assert "removed 2 sessions" in done.stdout
    assert f"warning: {stuck[0].parent} cannot be removed: Device or resource busy" in done.stdout
    assert f"warning: {stuck[1]}: Device or resource busy" in done.stdout
    assert names(tmp_path / name_of(6)) == ["metadata.yaml", "session.mcap"]
    assert names(tmp_path)[1:] == [name_of(day) for day in (4, 5, 6)]
    assert archive(tmp_path, "--keep-sessions=3").returncode == 0
    assert names(tmp_path) == [name_of(day) for day in (4, 5, 6)]


def test_the_oldest_is_what_began_first_whatever_the_clock_said(tmp_path: Path) -> None:
    times = [
        datetime(2026, 11, 20, tzinfo=UTC),
        datetime(2026, 11, 21, tzinfo=UTC),
        *[datetime(1970, 1, 1, tzinfo=UTC)] * 2,  # without a battery, and before any network
        datetime(2025, 1, 1, tzinfo=UTC),
    ]
    made = [create_session_folder(tmp_path, "robot", time.timetuple()) for time in times]
    for each in made:
        announce(each)
    for folder in made:
        BagWriter(folder / "session.mcap").close()
    done = archive(tmp_path, "--keep-sessions=2")
    assert f"the latest of them {made[2].name}" in done.stdout
    kept = sorted(name for name in names(tmp_path) if name not in {".order", "latest"})
    assert kept == sorted(folder.name for folder in made[3:])
    # One from before there was an order is older than all that are in it.
    past_session(tmp_path, 25)
    archive(tmp_path, "--keep-sessions=2")
    assert name_of(25) not in names(tmp_path)
    assert all(folder.exists() for folder in made[3:])


COMPLETE = """
import sys
from pathlib import Path
from play_launch.postmortem.archive import complete_session
complete_session(Path(sys.argv[1]))
"""


def test_killed_at_any_moment_it_leaves_a_session_that_can_be_completed(tmp_path: Path) -> None:
    folder = cut_off_session(tmp_path, 1, lines=5000)
    half = folder / "session.mcap.recovering"
    with subprocess.Popen([sys.executable, "-c", COMPLETE, str(folder)]) as process:
        while process.poll() is None and not half.exists():
            os.sched_yield()
        process.send_signal(signal.SIGKILL)
    # On a busy machine it may have come to its end before it was killed.
    assert {"session.mcap.active", "session.mcap"} & set(names(folder))
    complete_session(folder)
    assert names(folder) == ["metadata.yaml", "session.mcap"]
    assert sum(1 for _ in BagReader(folder).messages()) == 5000
