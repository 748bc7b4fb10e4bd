"""Which folders are ours, and that nothing else is ever removed."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING

import pytest

from play_launch.cli.export import export as export_session
from play_launch.cli.output import whole_file
from play_launch.cli.report import report as write_report
from play_launch.config.model import KeepConfig
from play_launch.postmortem.archive import (
    REMOVING,
    list_sessions,
    remove,
    remove_session,
    session_entry,
)
from play_launch.recording.folder import CONTROL_SOCKET
from tests.postmortem.archive.scenes import begin_session, cut_off_session, name_of, past_session
from tests.postmortem.scenes import Scene

if TYPE_CHECKING:
    from pathlib import Path


def everything(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_what_holds_for_each(tmp_path: Path) -> None:
    past_session(tmp_path, 1, parts=3)
    _, writer = begin_session(tmp_path, 2)
    writer.flush()
    cut_off_session(tmp_path, 3)
    (past_session(tmp_path, 4) / "pinned").touch()
    (tmp_path / "latest").symlink_to(name_of(2))
    first, second, third, fourth = list_sessions(tmp_path)
    assert [each.name for each in (first, second, third, fourth)] == [
        name_of(day) for day in (1, 2, 3, 4)
    ]
    assert (first.is_running, first.active, first.is_pinned) == (False, (), False)
    assert first.size >= sum(path.stat().st_size for path in (tmp_path / first.name).iterdir())
    assert (second.is_running, second.active) == (True, ("session.mcap.active",))
    assert (third.is_running, third.active) == (False, ("session.mcap.active",))
    assert fourth.is_pinned
    writer.close()


def test_removed_is_what_neither_runs_nor_is_pinned(tmp_path: Path) -> None:
    gone = past_session(tmp_path, 1, parts=2)
    cut = cut_off_session(tmp_path, 2)
    running, writer = begin_session(tmp_path, 3)
    pinned = past_session(tmp_path, 4)
    (pinned / "notes.txt").write_text("look at this")
    assert [remove_session(each) for each in (gone, cut, running, pinned)] == [
        True,
        True,
        False,
        False,
    ]
    writer.close()
    assert {path.name for path in tmp_path.iterdir()} == {running.name, pinned.name}
    assert everything(pinned) == {"notes.txt", "session.mcap", "metadata.yaml"}


def test_what_is_made_in_its_usual_place_keeps_nothing(tmp_path: Path) -> None:
    scene = Scene()
    scene.machine(1)
    session = past_session(tmp_path, 1, parts=2)
    scene.record(session / "session_2.mcap")
    for recording in (session, session / "session_1.mcap"):
        assert not write_report(recording, None)
        assert not export_session(recording, "perfetto", None)
        assert not export_session(recording, "csv", None)
    for name in ("session.html",):
        with whole_file(session / name) as half:
            half.touch()
            os.link(half, half.with_name(half.name.replace(str(os.getpid()), "4711")))  # killed
    made = {"session.html", "session_1.html", "session.trace.json", "session_1.trace.json"}
    assert made | {"session-csv/machine.csv"} < everything(session)
    (entry,) = list_sessions(tmp_path)
    assert not entry.is_pinned
    for mine in ("mine.html", "session.csv", "session-xml"):
        (session / mine).touch()
        before = everything(session)
        assert not remove_session(session)
        assert everything(session) == before
        (session / mine).unlink()
    assert remove_session(session)
    assert list(tmp_path.iterdir()) == []


def test_the_socket_of_a_killed_session_keeps_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import socket

    folder = cut_off_session(tmp_path, 1)
    monkeypatch.chdir(folder)  # the path of a socket may have 107 bytes
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(CONTROL_SOCKET)
    monkeypatch.undo()
    (entry,) = list_sessions(tmp_path)
    assert not entry.is_pinned
    assert remove_session(folder)
    assert list(tmp_path.iterdir()) == []


def strangers(log_folder: Path, outside: Path) -> None:
    """All kinds of things that are no session, most of them with a name like one."""
    real = past_session(outside, 9)
    (log_folder / name_of(1)).symlink_to(real)
    (log_folder / name_of(2)).write_text("a file")
    (log_folder / name_of(3)).mkdir()
    (log_folder / name_of(4)).mkdir()
    (log_folder / name_of(4) / "session.mcap").symlink_to(real / "session.mcap")
    (log_folder / name_of(5)).mkdir()
    (log_folder / name_of(5) / "session.mcap").write_bytes(b"\x89MCAP0\r\nsomebody else's")
    (log_folder / name_of(6)).mkdir()
    os.mkfifo(log_folder / name_of(6) / "session.mcap")
    shutil.copytree(real, log_folder / "my-recordings")
    deep = past_session(log_folder, 7)
    (deep / "more").mkdir()
    (deep / "more" / "session.mcap").touch()


def test_nothing_else_is_a_session_and_no_link_is_followed(tmp_path: Path) -> None:
    logs, outside = tmp_path / "logs", tmp_path / "outside"
    logs.mkdir()
    strangers(logs, outside)
    before = everything(tmp_path)
    assert [one.name for one in list_sessions(logs) if not one.is_pinned] == []
    for path in logs.iterdir():
        assert not remove_session(path)
    errors: list[str] = []
    remove(logs, KeepConfig(), errors)
    assert errors == []
    assert everything(tmp_path) == before


def test_a_removal_that_was_killed_is_finished(tmp_path: Path) -> None:
    folder = past_session(tmp_path, 1, parts=2)
    going = folder.rename(tmp_path / (REMOVING + folder.name))
    (going / "session.mcap").unlink()
    assert list_sessions(tmp_path) == []
    remove(tmp_path, KeepConfig(), [])
    assert list(tmp_path.iterdir()) == []


def test_what_came_into_a_folder_at_the_last_moment_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from play_launch.postmortem import archive

    folder = past_session(tmp_path, 1)
    entry = session_entry(folder)
    (folder / "notes.txt").touch()
    monkeypatch.setattr(archive, "session_entry", lambda _: entry)
    before = everything(tmp_path)
    assert not remove_session(folder)
    assert everything(tmp_path) == before


def test_no_log_folder_no_sessions(tmp_path: Path) -> None:
    assert list_sessions(tmp_path / "none") == []
