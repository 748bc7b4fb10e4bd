"""Publishers and subscriptions of the ROS graph, and which of them do not connect."""

from __future__ import annotations

import re
from itertools import product
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec import Struct

from play_launch.config.text import listed

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

UNCHECKED: Final = frozenset({"/rosout", "/parameter_events"})
"""Topics that every node has."""
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


class Endpoint(Struct, frozen=True, order=True):
    """A publisher with what it offers, or a subscription with what it requests.

    The fields are those of ``play_launch_msgs/GraphEndpoint``.
    """

    topic: str
    node: str
    """Full name."""
    type: str
    """``package/msg/Name``."""
    is_publisher: bool
    reliability: int = 0
    durability: int = 0
    liveliness: int = 0
    deadline: int = 0
    """Nanoseconds, as the next one; 0: no limit."""
    lease_duration: int = 0

    @property
    def is_hidden(self) -> bool:
        """Whether its node is one of a tool, such as ``ros2 topic echo``."""
        return self.node.rpartition("/")[2].startswith("_")


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
    from difflib import SequenceMatcher  # noqa: PLC0415 - few need it

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
