"""Samples of a session of any length take bounded memory, and say the same."""

from __future__ import annotations

import tracemalloc

from play_launch.container.cdr.messages import PROCESS_STATS, SYSTEM_STATS
from play_launch.postmortem.bag_reader import Message, RecordedTopic
from play_launch.postmortem.samples import MOST_SAMPLES, Samples

SECOND = 1_000_000_000


def sample(at: int, memory: int, cpu_seconds: float) -> Message:
    values = {"pid": 7, "memory_bytes": memory, "memory_kind": 1, "cpu_seconds": cpu_seconds}
    topic = RecordedTopic("/play_launch/node/a/stats", "", "cdr", "process", "/a")
    return Message(topic, at * SECOND, at * SECOND, PROCESS_STATS.write(values), 1, 0, 0)


def test_a_session_of_days_is_thinned_out() -> None:
    samples = Samples()
    count = 5 * MOST_SAMPLES
    for at in range(1, count):
        memory = 10**12 if at == 3 else 10**7 + at * 10**5
        samples.of("/a")(sample(at, memory, at / 4))
    assert samples.peak_memory() == {"/a": 10**12}
    assert abs(samples.mean_cpu()["/a"] - 25) < 0.1
    (trend,) = samples.before("/a", "/a", 7, count * SECOND)
    assert trend.end_ns == (count - 1) * SECOND
    assert trend.before < 10**9
    assert trend.after == 10**7 + (count - 1) * 10**5


def test_a_leak_of_days_is_found_from_its_beginning() -> None:
    samples = Samples()
    count = 6 * MOST_SAMPLES
    take = samples.of("/a")
    for at in range(1, count):
        take(sample(at, 10**8 + at * 10**5, 0.0))
    ((key, trend),) = samples.leaks()
    assert key == "/a"
    assert abs(trend.begin_ns / SECOND / count - 0.1) < 0.01
    assert trend.after > 5 * trend.before


def machine(at: int, pressure: float) -> Message:
    values = {"cpu_some_avg10": pressure, "core_percent": [1.0] * 16, "disk_free": at}
    topic = RecordedTopic("/play_launch/system", "", "cdr")
    return Message(topic, at * SECOND, at * SECOND, SYSTEM_STATS.write(values), 1, 0, 0)


def used(at: int, cpu_seconds: float, switches: int) -> Message:
    values = {"pid": 7, "cpu_seconds": cpu_seconds, "involuntary_switches": switches}
    topic = RecordedTopic("/play_launch/node/a/stats", "", "cdr", "process", "/a")
    return Message(topic, at * SECOND, at * SECOND, PROCESS_STATS.write(values), 1, 0, 0)


def test_no_busy_time_of_a_session_of_days_is_missed() -> None:
    samples = Samples()
    count, busy = 3 * MOST_SAMPLES, range(9, 13)
    hog, victim = samples.of("/hog"), samples.of("/victim")
    for at in range(1, count):
        hog(used(at, at, 0))
        victim(used(at, 0.0, at * 50))
        samples.take_system(machine(at, 99.0 if at % MOST_SAMPLES in busy else 0.0))
    found = samples.starvations()
    assert [each.begin_ns // SECOND % MOST_SAMPLES for each in found] == [busy[0]] * 3
    assert {(each.key, each.hit) for each in found} == {("/hog", ("/victim",))}
    trend = samples.disk_free_at_the_end()
    assert trend is not None
    assert (trend.before, trend.after) == (1, count - 1)


def test_samples_take_little_more_than_their_bytes() -> None:
    samples = Samples()
    tracemalloc.start()
    try:
        for at in range(1, MOST_SAMPLES):
            samples.of("/a")(sample(at, 1, 1.0))
        size, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert size < MOST_SAMPLES * 1.3 * (len(sample(1, 1, 1.0).data) + 8)


def test_one_sample_says_how_much_there_was() -> None:
    samples = Samples()
    samples.of("/a")(sample(1, 5, 0.1))
    assert samples.peak_memory() == {"/a": 5}
    assert samples.mean_cpu() == {}
    assert samples.before("/a", "/a", 7, 2 * SECOND) == ()
