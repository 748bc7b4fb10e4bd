"""Samples of a session of any length take bounded memory, and say the same."""

from __future__ import annotations

import tracemalloc
from functools import cache
from struct import Struct
from typing import Any

import pytest

from play_launch.container.cdr.messages import PROCESS_STATS, SYSTEM_STATS
from play_launch.postmortem.bag_reader import Message, RecordedTopic
from play_launch.postmortem.detect.resources import _leaks
from play_launch.postmortem.mcap_records import ChannelSequence, EqualMessages
from play_launch.postmortem.samples import MOST_SAMPLES, Samples
from tests.postmortem.scenes import channel_of, message_record

SECOND = 1_000_000_000


@cache
def sequence(keys: tuple[str, ...]) -> ChannelSequence:
    channels = tuple(channel_of(f"{key}/stats", key) for key in keys)
    return ChannelSequence(channels, len(message_record(PROCESS_STATS.write({}), 0)), Struct(""))


def take(samples: Samples, at: float, **units: dict[str, Any]) -> None:
    """Take a sample of each unit, as they stand in a file."""
    records = b"".join(
        message_record(
            PROCESS_STATS.write({"pid": 7, "memory_kind": 1, **values}), round(at * SECOND)
        )
        for values in units.values()
    )
    keys = tuple(f"/{name}" for name in units)
    samples.add(EqualMessages(records, sequence(keys), 0))


@pytest.mark.parametrize("is_divided", [False, True])
def test_a_session_of_days_is_thinned_out(is_divided: bool) -> None:
    samples = Samples()
    count = 5 * MOST_SAMPLES
    for at in range(1, count):
        memory = 10**12 if at == 3 else 10**7 + at * 10**5
        used = {"memory_bytes": memory, "cpu_seconds": at / 4}
        if is_divided:  # by the end of a chunk
            take(samples, at, b={})
            take(samples, at + 0.01, a=used)
        else:
            take(samples, at, b={}, a=used)
    total = samples.totals()["/a"]
    assert total.peak_memory == 10**12
    assert total.mean_cpu is not None
    assert abs(total.mean_cpu - 25) < 0.1
    (trend,) = samples.before("/a", "/a", 7, count * SECOND)
    assert trend.end_ns // SECOND == count - 1
    assert trend.before < 10**9
    assert trend.after == 10**7 + (count - 1) * 10**5
    assert len(samples.life("/a")) > MOST_SAMPLES // 4


def test_a_leak_of_days_is_found_from_its_beginning() -> None:
    samples = Samples()
    count = 6 * MOST_SAMPLES
    for at in range(1, count):
        take(samples, at, a={"memory_bytes": 10**8 + at * 10**5})
    (trend,) = _leaks(samples, "/a")
    assert abs(trend.begin_ns / SECOND / count - 0.1) < 0.01
    assert trend.after > 5 * trend.before


def machine(at: int, pressure: float) -> Message:
    values = {"cpu_some_avg10": pressure, "core_percent": [1.0] * 16, "disk_free": at}
    topic = RecordedTopic("/play_launch/system", "", "cdr")
    return Message(topic, at * SECOND, at * SECOND, SYSTEM_STATS.write(values), 1, 0)


def test_no_busy_time_of_a_session_of_days_is_missed() -> None:
    samples = Samples()
    count, busy = 3 * MOST_SAMPLES, range(9, 13)
    for at in range(1, count):
        take(samples, at, hog={"cpu_seconds": at}, victim={"involuntary_switches": at * 50})
        samples.take_system(machine(at, 99.0 if at % MOST_SAMPLES in busy else 0.0))
    found = samples.busy_times()
    assert [each.begin_ns // SECOND % MOST_SAMPLES for each in found] == [busy[0]] * 3
    for each in found:
        assert [(*rate[:2], rate.preempted) for rate in each.rates] == [
            ("/hog", 100.0, 0.0),
            ("/victim", 0.0, 50.0),
        ]
    trend = samples.disk_free_at_the_end()
    assert trend is not None
    assert (trend.before, trend.after) == (1, count - 1)


def test_samples_take_little_more_than_their_bytes() -> None:
    samples, units = Samples(), {f"unit{number}": {"pid": number} for number in range(20)}
    size = len(message_record(PROCESS_STATS.write({}), 0))
    take(samples, 0, **units)
    tracemalloc.start()
    try:
        for at in range(1, MOST_SAMPLES // 10):
            take(samples, at, **units)
        taken, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert taken < MOST_SAMPLES // 10 * len(units) * size * 1.25


def test_samples_of_one_unit_behind_each_other_are_all_kept() -> None:
    """As in a file that was recovered, whose chunks are long."""
    samples = Samples()
    data = PROCESS_STATS.write({"pid": 7, "memory_bytes": 5})
    records = b"".join(message_record(data, at) for at in range(1, 50))
    samples.add(EqualMessages(records, sequence(("/a",) * 49), 0))
    assert [each.of("/a").log_time for each in samples.life("/a")] == list(range(1, 50))


def test_one_sample_says_how_much_there_was() -> None:
    samples = Samples()
    take(samples, 1, a={"memory_bytes": 5, "cpu_seconds": 0.1})
    total = samples.totals()["/a"]
    assert (total.peak_memory, total.mean_cpu) == (5, None)
    assert samples.before("/a", "/a", 7, 2 * SECOND) == ()
