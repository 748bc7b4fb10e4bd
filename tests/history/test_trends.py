"""Samples of a session of any length take bounded memory, and say the same."""

from __future__ import annotations

from play_launch.cdr.messages import PROCESS_STATS
from play_launch.history.bag_reader import Message, Topic
from play_launch.history.trends import MOST_SAMPLES, Samples

SECOND = 1_000_000_000


def sample(at: int, memory: int, cpu_seconds: float) -> Message:
    values = {"pid": 7, "memory_bytes": memory, "memory_kind": 1, "cpu_seconds": cpu_seconds}
    topic = Topic("/play_launch/node/a/stats", "", "cdr", "process", "/a")
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


def test_one_sample_says_how_much_there_was() -> None:
    samples = Samples()
    samples.of("/a")(sample(1, 5, 0.1))
    assert samples.peak_memory() == {"/a": 5}
    assert samples.mean_cpu() == {}
    assert samples.before("/a", "/a", 7, 2 * SECOND) == ()
