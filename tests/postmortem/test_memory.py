"""What a timeline keeps of a session is bounded, however long the session was."""

from __future__ import annotations

import gc
import sys
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import TYPE_CHECKING

from msgspec import Struct

from play_launch.postmortem import parameters, samples, timeline, units
from play_launch.postmortem.last_lines import MOST_LOGGERS
from play_launch.postmortem.timeline import read_timeline
from play_launch.supervisor.events import NodeState, ProcessEventKind
from tests.postmortem.scenes import NAN, Scene

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

_CODE = (type, ModuleType, FunctionType, BuiltinFunctionType, MethodType)


def size_of(root: object) -> int:
    """Bytes of all objects that can be reached from one."""
    seen, left, size = {id(root)}, [root], 0
    while left:
        each = left.pop()
        size += sys.getsizeof(each)
        found = gc.get_referents(each)
        if isinstance(each, Struct):  # the collector knows nothing of some of them
            found = [getattr(each, name) for name in each.__struct_fields__]
        for one in found:
            if id(one) not in seen and not isinstance(one, _CODE):
                seen.add(id(one))
                left.append(one)
    return size


def kept(path: Path, seconds: int) -> int:
    """Read a session of that length; return what the timeline keeps of it."""
    scene = Scene()
    scene.started()
    for at in range(1, seconds):
        busy = at % 20 < 5
        scene.machine(at, cpu_some_avg10=99.0 if busy else NAN)
        scene.used(at, "/hog", pid=at // 50 + 1, cpu_seconds=at % 50)
        scene.used(at, "/box:/talker", involuntary_switches=at * 50)
        scene.group(at, "/hog", throttled_seconds=at / 2, oom_kills=at, pids_max_hits=at)
        scene.line(at, f"[INFO] [{at}.0] [logger_{at}]: {at}")
        scene.line(at, f"[WARN] [{at}.0] [a]: offering incompatible QoS {at}")
        if at % 5 == 0:
            scene.parameters_changed(at, "/talker", changed={"speed": at})
            scene.node(at, "/talker", NodeState.LOADED, crashes=at, pid=at)
            scene.crashed(at, "/talker", crashes=at, pid=at)
            scene.process(at, ProcessEventKind.STARTED, "/hog", pid=at)
            scene.process(at, ProcessEventKind.EXITED, "/hog", pid=at, exit_code=1)
    path.mkdir()
    found = read_timeline(scene.record(path / "session.mcap"))
    assert found.session.reader.damages == []
    found.session.reader.counts.clear()
    return size_of(found)


def test_what_is_kept_does_not_grow_with_the_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, name in (
        (samples, "MOST_SAMPLES"),
        (samples, "_RECENT"),
        (samples, "_MOST_BUSY_TIMES"),
        (timeline, "MOST_CHANGES"),
        (timeline, "MOST_EVENTS"),
        (timeline, "MOST_TIMES"),
        (units, "MOST_TIMES"),
        (parameters, "_MOST_CHANGES"),
    ):
        monkeypatch.setattr(module, name, 50)
    monkeypatch.setattr(samples, "MOST_SAMPLES", 200)
    least = 2 * MOST_LOGGERS
    short, long = kept(tmp_path / "short", least), kept(tmp_path / "long", 2 * least)
    assert long < 1.05 * short
