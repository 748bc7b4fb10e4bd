"""Sampling beside the event loop: never in its way, and never a burst."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.postmortem.past_session import PastSession
from play_launch.process.sampling import machine, sampling
from play_launch.process.sampling.sampling import next_due, sample
from play_launch.supervisor.events import (
    MemoryKind,
    ProcessSample,
    RunEvent,
    SubjectKind,
    SystemSample,
)
from play_launch.supervisor.view import SystemView
from tests.support.replay import replaying
from tests.support.waiting import until

PERIOD = 0.01
SECONDS = st.floats(0, 1e6)


@given(SECONDS, st.floats(0, 1e5), st.floats(0.1, 3600))
def test_what_comes_late_is_not_made_up_for(due: float, late: float, period: float) -> None:
    now = due + late
    following = next_due(due, now, period)
    assert following - now >= period / 2 - 1e-6
    assert following - now <= period + 1e-6
    if late <= period / 2:
        assert following == due + period, "the grid stays"


def refused(event: RunEvent) -> None:
    pytest.fail(str(event))


async def run_until(enough: int, folder: Path) -> list[RunEvent]:
    events: list[RunEvent] = []
    done = asyncio.Event()

    def publish(event: RunEvent) -> None:
        events.append(event)
        if len(events) >= enough:
            done.set()

    task = asyncio.create_task(sample(SystemView, publish, period=PERIOD, folder=folder))
    await asyncio.wait([task, asyncio.create_task(done.wait())], return_when="FIRST_COMPLETED")
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return events


def test_without_proc_there_is_one_warning_and_no_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def core_times(_: str) -> None:
        raise FileNotFoundError(2, "No such file or directory", "/proc/stat")

    monkeypatch.setattr(machine, "core_times", core_times)

    async def run() -> None:
        await sample(SystemView, refused, period=PERIOD, folder=tmp_path)

    asyncio.run(run())
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert "not sampled" in record.getMessage()
    assert "/proc/stat" in record.getMessage()
    assert record.exc_info is None


def test_a_sample_that_fails_is_reported_once_and_others_follow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    count = 0
    measure = machine.MachineSampler.sample

    def measured(self: machine.MachineSampler, stamp_ns: int) -> SystemSample:
        nonlocal count
        count += 1
        if count in {2, 3}:
            raise OSError(24, "Too many open files", "/proc/meminfo")
        return measure(self, stamp_ns)

    monkeypatch.setattr(machine.MachineSampler, "sample", measured)
    assert len(asyncio.run(run_until(3, tmp_path))) >= 3
    (record,) = caplog.records
    assert "Too many open files: '/proc/meminfo'" in record.getMessage()


def test_a_process_that_does_not_answer_delays_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    answer, asked = threading.Event(), threading.Event()

    def core_times(_: str) -> None:
        asked.set()
        answer.wait()
        raise FileNotFoundError

    monkeypatch.setattr(machine, "core_times", core_times)
    monkeypatch.setattr(sampling, "_REPORT_AFTER", 0.01)

    async def run() -> None:
        task = asyncio.create_task(sample(SystemView, refused, period=PERIOD, folder=tmp_path))
        while not caplog.records:
            await asyncio.sleep(0.01)
        assert asked.is_set()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    asyncio.run(run())
    assert "does not answer" in caplog.records[0].getMessage()
    answer.set()


CONFIG = """
version: 1
record: {sampling: {period: 100 ms}}
containers:
  - name: chat
    container_type: isolated
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
      - {package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}
nodes:
  - {name: hog, command: [python3, -c, "while True: pass"]}
"""


def batches(path: Path) -> list[dict[str, ProcessSample]]:
    """The samples that were taken together, by key, where none is missing."""
    by_stamp: dict[int, dict[str, ProcessSample]] = {}
    for happened in PastSession(path).events():
        if isinstance(happened.event, ProcessSample):
            by_stamp.setdefault(happened.event.stamp_ns, {})[happened.event.key] = happened.event
    return [batch for batch in by_stamp.values() if len(batch) == 4]


def test_a_run_is_recorded_in_numbers(tmp_path: Path) -> None:
    config = tmp_path / "numbers.yaml"
    config.write_text(CONFIG, encoding="utf-8")
    with replaying(config, tmp_path / "logs") as run:
        run.read_until_states({"/talker": "loaded", "/listener": "loaded"})
        active = run.bag.with_name("session.mcap.active")
        until(lambda: len(batches(active)) >= 3, "three samples of each")
    assert not [event for event in run.seen if "sample" in event["event"]], "too many to be shown"
    pids = {
        event["key"]: event["pid"]
        for event in run.seen
        if event["event"] == "node" and event["state"] == "loaded"
    }
    whole = batches(run.bag)
    assert len(whole) >= 3
    for batch in whole:
        assert batch["/chat"].kind is SubjectKind.CONTAINER
        assert batch["/chat"].memory_kind is MemoryKind.PSS
        for key in ("/chat:/talker", "/chat:/listener"):
            assert batch[key].kind is SubjectKind.NODE
            assert batch[key].pid == pids[key]
            assert batch[key].memory_kind is MemoryKind.SHARED
            assert batch[key].memory_bytes == batch["/chat"].memory_bytes
        assert batch["/hog"].kind is SubjectKind.PROCESS
        assert batch["/hog"].cpu_seconds > batch["/chat:/talker"].cpu_seconds


def test_json_has_null_for_what_is_not_a_number() -> None:
    from play_launch.cli.show.display import encode
    from play_launch.control.event_words import event_object

    values = dict.fromkeys(SystemSample.__struct_fields__, float("nan"))
    event = SystemSample(**{**values, "core_percent": (1.0, float("nan"))})  # type: ignore[arg-type]
    assert json.loads(encode(event_object(event)), parse_constant=pytest.fail) == {
        "event": "system_sample",
        **dict.fromkeys(SystemSample.__struct_fields__),
        "core_percent": [1.0, None],
    }
