"""Whether topics are as expected, judged by what was measured of them in the latest seconds."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.config.expectations import Durability, Reliability
from play_launch.supervisor.events import ExpectationChanged

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.config.expectations import Expectation

_SPAN: Final = 3.0
"""Seconds over which a rate is measured, at least."""
_MESSAGES: Final = 5
"""Messages of the least rate that fit into that span, at least."""
_SETTLES: Final = 10.0
"""Seconds after the start of the system in which nothing is expected yet."""
_AGREE: Final = {True: 3, False: 2}
"""Judgements in a row that it takes until it is met, or broken."""
_HELD_UP_NS: Final = 3_000_000_000
"""A measurement over more time says that what measures was held up, not the topic."""


class Measured(Struct, frozen=True):
    """What came on a topic since the measurement before, about a second ago."""

    topic: str
    types: str
    """Of its publishers and subscriptions; empty while there are none."""
    publishers: int
    reliable: int
    """Publishers that deliver every message."""
    latched: int
    """Publishers that keep messages for later subscriptions."""
    messages: int
    gap_ns: int
    """Between two messages, or since the latest one; at most."""
    span_ns: int


class TopicState(Struct, frozen=True):
    """What is known of a topic of which something is expected; rate and gap are None at first."""

    topic: str
    is_met: bool | None = None
    """None: not known yet."""
    reason: str = ""
    publishers: int = 0
    type: str = ""
    rate: float | None = None
    """Messages per second."""
    max_gap: float | None = None
    """Seconds, in the time over which the rate is measured."""
    breaks: int = 0
    """How often it was broken."""


class Expectations:
    """What is expected, and whether it is so; pure."""

    def __init__(self, expected: Mapping[str, Expectation]) -> None:
        self._topics = {topic: _Topic(each) for topic, each in expected.items()}

    @property
    def states(self) -> tuple[TopicState, ...]:
        return tuple(each.state for each in self._topics.values())

    @property
    def unmet(self) -> tuple[TopicState, ...]:
        return tuple(each for each in self.states if not each.is_met)

    def take(
        self, measured: Measured, stamp_ns: int, *, is_up: bool = True
    ) -> Iterator[ExpectationChanged]:
        """Take a measurement; yield the event of the change that follows from it, if any.

        Before the system is up for the first time, a topic can be found met, not broken.
        """
        topic = self._topics.get(measured.topic)
        if topic is not None and topic.take(measured, is_up=is_up):
            yield _event(topic.state, stamp_ns)

    def forget(self, reason: str) -> None:
        """Take that nothing measures the topics now, and why; no change follows from that."""
        for topic in self._topics.values():
            topic.forget(reason)


def _event(state: TopicState, stamp_ns: int) -> ExpectationChanged:
    return ExpectationChanged(
        stamp_ns=stamp_ns, topic=state.topic, is_met=bool(state.is_met), reason=state.reason
    )


class _Topic:
    def __init__(self, expected: Expectation) -> None:
        self._expected = expected
        self._window: deque[Measured] = deque()
        self._seconds = 0.0
        """In which it was measured while the system was up."""
        self._judged: bool | None = None
        self._agreeing = 0
        """Equal judgements in a row."""
        self._told: bool | None = None
        """Whether it was met by the latest change; None before the first one."""
        self.state = TopicState(expected.topic)
        least = _MESSAGES / expected.min_rate if expected.min_rate else 0.0
        gap = expected.max_gap if math.isfinite(expected.max_gap) else 0.0
        self._span_ns = max(_SPAN, least, gap) * 1e9

    def take(self, measured: Measured, *, is_up: bool) -> bool:
        """Take a measurement; whether the state has changed."""
        if measured.span_ns > _HELD_UP_NS:
            self._window.clear()
            self._agreeing = 0
            return False
        self._window.append(measured)
        self._seconds += measured.span_ns / 1e9 if is_up else 0.0
        while sum(each.span_ns for each in self._window) - self._window[0].span_ns >= self._span_ns:
            self._window.popleft()
        seconds = sum(each.span_ns for each in self._window) / 1e9
        is_full = seconds * 1e9 >= 0.9 * self._span_ns
        rate = sum(each.messages for each in self._window) / seconds
        gap = max(each.gap_ns for each in self._window) / 1e9
        was = self.state
        problems = "; ".join(differences(self._expected, measured, rate, gap, whole=is_full))
        is_met = not problems
        self._agreeing = self._agreeing + 1 if is_met is self._judged else 1
        self._judged = is_met
        is_sure = self._agreeing >= _AGREE[is_met] and (is_full if is_met else self._is_due)
        changes = is_sure and is_met is not self._told
        self._told = is_met if is_sure else self._told
        self.state = TopicState(
            topic=was.topic,
            is_met=is_met if is_sure else was.is_met,
            reason=problems,
            publishers=measured.publishers,
            type=measured.types,
            rate=rate,
            max_gap=gap,
            breaks=was.breaks + (changes and not is_met),
        )
        return changes

    def forget(self, reason: str) -> None:
        self._window.clear()
        self._seconds = 0.0
        self._agreeing = 0
        self.state = TopicState(self.state.topic, reason=reason, breaks=self.state.breaks)

    @property
    def _is_due(self) -> bool:
        """Whether it is not too early to find it broken."""
        return self.state.is_met is not None or self._seconds >= max(_SETTLES, self._span_ns / 1e9)


def differences(
    expected: Expectation, latest: Measured, rate: float, gap: float, *, whole: bool = True
) -> Iterator[str]:
    """Say what is not as expected; ``rate`` in messages per second, ``gap`` in seconds.

    Without ``whole``, it is too early to judge the rate.
    """
    if expected.publishers is not None and latest.publishers != expected.publishers:
        yield f"{_count(latest.publishers)} instead of {expected.publishers}"
    elif not latest.publishers and expected.publishers is None:
        yield "no publisher"
    if not latest.publishers:
        return
    if expected.type and latest.types != expected.type:
        yield f"its type is {latest.types}, expected {expected.type}"
    for wanted, full, empty, having in (
        (expected.reliability, Reliability.RELIABLE, Reliability.BEST_EFFORT, latest.reliable),
        (expected.durability, Durability.TRANSIENT_LOCAL, Durability.VOLATILE, latest.latched),
    ):
        if wanted is not None:
            others = latest.publishers - having if wanted is full else having
            verb = "offers" if others == 1 else "offer"
            if others:
                yield f"{_count(others)} {verb} {empty if wanted is full else full}"
    if rate < expected.min_rate and whole:
        yield f"{rate:.3g} Hz, expected at least {expected.min_rate:.3g} Hz"
    if rate > expected.max_rate and whole:
        yield f"{rate:.3g} Hz, expected at most {expected.max_rate:.3g} Hz"
    if gap > expected.max_gap:
        yield f"no message for {gap:.3g} s, expected at most {expected.max_gap:.3g} s"


def _count(publishers: int) -> str:
    return f"{publishers} publisher{'' if publishers == 1 else 's'}"
