"""Which publishers and subscriptions of the ROS graph do not connect, and for how long."""

from __future__ import annotations

import re
from collections import Counter
from difflib import SequenceMatcher
from itertools import product
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.text import listed
from play_launch.supervisor.endpoints import UNCHECKED
from play_launch.supervisor.events import ProcessEventKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from play_launch.supervisor.endpoints import Endpoint
    from play_launch.supervisor.events import GraphChanged, ProcessEvent

_ACTION_STATUS: Final = "/_action/status"
"""Every action has it beside its feedback."""
_CLOSE: Final = 0.8
"""Similarity of two words (`difflib`) from which one may be a misspelling of the other."""
_MANY: Final = 8
"""Nodes that are listed."""
_DIGITS: Final = re.compile("[0-9]+")
_WORDS: Final = {
    "reliability": {1: "reliable", 2: "best_effort"},
    "durability": {1: "transient_local", 2: "volatile"},
    "liveliness": {1: "automatic", 3: "manual_by_topic"},
}
"""By the numbers of rmw; others are unknown, and match everything."""
_LASTING: Final = 5_000_000_000
"""Nanoseconds; what lasts shorter is discovery, a reload, or the end."""
_ENDS: Final = frozenset({ProcessEventKind.STOPPING, ProcessEventKind.EXITED})
_MOST: Final = 1_000
"""Lacks and mismatches that are kept."""


class Mismatch(NamedTuple):
    """Publishers and subscriptions of one topic between which no message passes."""

    topic: str
    policy: str
    """``type``, or the policy of the quality of service."""
    offered: str
    requested: str
    publishers: tuple[str, ...]
    """Names of the nodes, as the next one."""
    subscribers: tuple[str, ...]
    odd: str
    """``publishers`` or ``subscribers``: those that match no others; empty: neither or both."""

    def __str__(self) -> str:
        """Write what differs, and which side has to change."""
        publishers, subscribers = listed(self.publishers, _MANY), listed(self.subscribers, _MANY)
        if self.policy == "type":
            does = f"{publishers} publishes {self.offered}"
            return f"{does}, {subscribers} subscribes to {self.requested}"
        sides = {
            "publishers": f"offer {self.requested} in {publishers}",
            "subscribers": f"request {self.offered} in {subscribers}",
        }
        return (
            f"{self.policy}: {publishers} offers {self.offered}, {subscribers} requests "
            f"{self.requested}; to change: {sides.get(self.odd, ' or '.join(sides.values()))}"
        )


class TopicConnections(NamedTuple):
    """The nodes of one topic, without those of tools where only these are on that side."""

    topic: str
    publishers: tuple[str, ...]
    """Names, as the next one."""
    subscribers: tuple[str, ...]
    has_publisher: bool
    """Also one of a tool."""
    mismatches: tuple[Mismatch, ...]


def connections(endpoints: Iterable[Endpoint]) -> Iterator[TopicConnections]:
    """Compare the endpoints of each topic."""
    by_topic: dict[str, list[Endpoint]] = {}
    for each in endpoints:
        if each.topic not in UNCHECKED and not each.topic.endswith(_ACTION_STATUS):
            by_topic.setdefault(each.topic, []).append(each)
    for topic, every in by_topic.items():
        shown = [each for each in every if not each.is_hidden]
        publishers = [each for each in shown if each.is_publisher]
        subscriptions = [each for each in shown if not each.is_publisher]
        yield TopicConnections(
            topic,
            _nodes(publishers),
            _nodes(subscriptions),
            any(each.is_publisher for each in every),
            tuple(_mismatches(topic, _by_request(publishers), _by_request(subscriptions))),
        )


def similar_topic(topic: str, endpoints: Iterable[Endpoint], *, unused: bool) -> str:
    """Name the published topic that subscriptions of ``topic`` may mean; empty without one.

    It has their type, and lacks or adds namespaces, or one word of it is spelled a little
    differently. With ``unused``, it has no subscriptions either.
    """
    every = list(endpoints)
    types = {each.type for each in every if each.topic == topic}
    used = {each.topic for each in every if not each.is_publisher and not each.is_hidden}
    candidates = (
        each.topic
        for each in every
        if each.is_publisher and each.type in types and not (unused and each.topic in used)
    )
    return min((each for each in candidates if _is_similar(topic, each)), key=len, default="")


def _is_similar(one: str, other: str) -> bool:
    shorter, longer = sorted((one.split("/"), other.split("/")), key=len)
    if len(shorter) < len(longer):
        words = iter(longer)
        return shorter[-1] == longer[-1] and all(word in words for word in shorter)
    differing = [pair for pair in zip(shorter, longer, strict=True) if pair[0] != pair[1]]
    if len(differing) != 1:
        return False
    # left_1 and left_2 are two things.
    first, second = (_DIGITS.sub("", word) for word in differing[0])
    return first != second and SequenceMatcher(None, *differing[0]).ratio() >= _CLOSE


def _by_request(endpoints: Sequence[Endpoint]) -> list[list[Endpoint]]:
    """Group those that offer, or request, the same; most topics have one group on each side."""
    groups: dict[tuple[str | int, ...], list[Endpoint]] = {}
    for each in endpoints:
        same = (
            each.type,
            each.reliability,
            each.durability,
            each.liveliness,
            each.deadline,
            each.lease_duration,
        )
        groups.setdefault(same, []).append(each)
    return list(groups.values())


def _mismatches(
    topic: str, publishers: list[list[Endpoint]], subscriptions: list[list[Endpoint]]
) -> Iterator[Mismatch]:
    pairs = list(product(range(len(publishers)), range(len(subscriptions))))
    found = {(p, s): list(_differences(publishers[p][0], subscriptions[s][0])) for p, s in pairs}
    matched = [pair for pair in pairs if not found[pair]]
    for p, s in pairs:
        is_odd = [not any(pair[side] == n for pair in matched) for side, n in ((0, p), (1, s))]
        odd = "" if is_odd[0] == is_odd[1] else "publishers" if is_odd[0] else "subscribers"
        names = _nodes(publishers[p]), _nodes(subscriptions[s])
        for policy, offered, requested in found[p, s]:
            yield Mismatch(topic, policy, offered, requested, *names, odd)


def _differences(publisher: Endpoint, subscription: Endpoint) -> Iterator[tuple[str, str, str]]:
    """Give each policy by which a pair does not match, what is offered and what is requested."""
    if publisher.type != subscription.type:
        yield "type", publisher.type, subscription.type
        return
    for policy, words in _WORDS.items():
        offered, requested = getattr(publisher, policy), getattr(subscription, policy)
        if offered not in words or requested not in words:
            continue
        # rmw numbers the first two from the strongest on.
        is_less = offered < requested if policy == "liveliness" else offered > requested
        if is_less:
            yield policy, words[offered], words[requested]
    for policy in ("deadline", "lease_duration"):
        offered, requested = getattr(publisher, policy), getattr(subscription, policy)
        if requested and (not offered or offered > requested):
            yield policy, _seconds(offered), _seconds(requested)


def _seconds(nanoseconds: int) -> str:
    return f"{nanoseconds / 1e9:g} s" if nanoseconds else "infinite"


def _nodes(endpoints: Iterable[Endpoint]) -> tuple[str, ...]:
    return tuple(sorted({each.node for each in endpoints}))


class Lack(NamedTuple):
    """A topic with subscriptions and no publisher, or the reverse."""

    topic: str
    of_publisher: bool
    begin_ns: int
    end_ns: int
    """0: until the end."""
    before: tuple[str, ...]
    """Nodes that it had on that side; empty: never any."""
    others: tuple[str, ...]
    """Nodes that it had on the other side."""


_Problem = tuple[str, bool] | Mismatch


class Connections:
    """The connections of the graph, as far as it was recorded, while the system runs."""

    def __init__(self) -> None:
        self.lacks: list[Lack] = []
        self.mismatches: dict[Mismatch, int] = {}
        """Those that lasted, and since when."""
        self._topics: dict[str, Counter[Endpoint]] = {}
        self._since: dict[str, dict[_Problem, int]] = {}
        """By topic."""
        self._last: dict[tuple[str, bool], tuple[str, ...]] = {}
        """Nodes that a topic had on a side when it had some there."""
        self._running: set[str] = set()
        self._stopped_ns = 0
        """Since when no process runs that is not being stopped."""
        self._later: list[GraphChanged] = []
        """What changed since then: it counts if a process is started again."""

    @property
    def endpoints(self) -> Iterator[Endpoint]:
        """Those at the end."""
        return (each for every in self._topics.values() for each in every)

    def run(self, event: ProcessEvent) -> None:
        """Take what happened to a process."""
        if event.kind in _ENDS:
            self._running.discard(event.name)
            if not self._running:
                self._stopped_ns = self._stopped_ns or event.stamp_ns
        elif event.kind is ProcessEventKind.STARTED:
            self._running.add(event.name)
            self._stopped_ns, later, self._later = 0, self._later, []
            for change in later:
                self.take(change)

    def take(self, event: GraphChanged) -> None:
        """Take a change of the graph."""
        if self._stopped_ns:
            self._later.append(event)
            return
        changed = (*event.endpoints_appeared, *event.endpoints_vanished)
        for each in event.endpoints_appeared:
            self._topics.setdefault(each.topic, Counter())[each] += 1
        for each in event.endpoints_vanished:
            # Minus: what was not recorded is not there.
            self._topics[each.topic] = self._topics.get(each.topic, Counter()) - Counter([each])
        for topic in dict.fromkeys(each.topic for each in changed):
            every = connections(self._topics[topic])
            found = [problem for now in every for problem in self._problems(now)]
            since = self._since.pop(topic, {})
            self._since[topic] = {each: since.pop(each, event.stamp_ns) for each in found}
            for problem, begin_ns in since.items():
                self._end(problem, begin_ns, event.stamp_ns, event.stamp_ns)

    def end(self, at_ns: int) -> None:
        """Finish: what is lacking was lacking until the end."""
        for since in self._since.values():
            for problem, begin_ns in since.items():
                self._end(problem, begin_ns, self._stopped_ns or at_ns, 0)

    def _problems(self, now: TopicConnections) -> Iterator[_Problem]:
        yield from now.mismatches
        for of_publisher, nodes in ((True, now.publishers), (False, now.subscribers)):
            if nodes:
                self._last[now.topic, of_publisher] = nodes
        if now.subscribers and not now.has_publisher:
            yield now.topic, True
        if now.publishers and not now.subscribers and (now.topic, False) in self._last:
            yield now.topic, False

    def _end(self, problem: _Problem, begin_ns: int, at_ns: int, end_ns: int) -> None:
        if at_ns - begin_ns < _LASTING or len(self.lacks) + len(self.mismatches) >= _MOST:
            return
        if isinstance(problem, Mismatch):
            self.mismatches.setdefault(problem, begin_ns)
            return
        topic, of_publisher = problem
        before = self._last.get((topic, of_publisher), ())
        others = self._last.get((topic, not of_publisher), ())
        self.lacks.append(Lack(topic, of_publisher, begin_ns, end_ns, before, others))
