"""Topics whose publishers and subscriptions do not connect, from the graph and from log lines."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from play_launch.config.text import duration, listed
from play_launch.postmortem.findings import DeclaredPlace, Finding
from play_launch.postmortem.units import Downtime
from play_launch.supervisor.endpoints import similar_topic

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from play_launch.postmortem.connections import Lack
    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import Failure
    from play_launch.supervisor.endpoints import Mismatch

_REPORT: Final = re.compile(
    r"\[(?P<logger>[^\]\s]+)\]: New (?P<other>publisher|subscription) discovered on topic "
    r"'(?P<topic>[^']+)', (?:offer|request)ing incompatible QoS\..*"
    r"incompatible policy: (?P<policy>\w+)",
    re.DOTALL,
)
_ORDER: Final = "a publisher has to offer as much as is requested (reliable, transient_local)"
_NEAR: Final = 5_000_000_000
"""Nanoseconds between a failure and what the graph lacks because of it, at most."""
_MOST_GUESSES: Final = 50
"""Topics without publisher for which similar ones are searched."""
_MANY: Final = 8
"""Topics or nodes that are listed."""


def detect(timeline: Timeline) -> Iterator[Finding]:
    by_topic: dict[str, dict[Mismatch, int]] = {}
    for mismatch, begin_ns in timeline.connections.mismatches.items():
        by_topic.setdefault(mismatch.topic, {})[mismatch] = begin_ns
    for topic, mismatches in by_topic.items():
        yield _mismatched(topic, mismatches)
    yield from _reported(timeline, by_topic.keys())
    yield from _disconnected(timeline)
    yield from _unpublished(timeline)
    yield from _unexpected(timeline)


def _unexpected(timeline: Timeline) -> Iterator[Finding]:
    """Report topics that were not as the configuration expects."""
    for topic, changes in timeline.expectations.items():
        ends = [*(each.stamp_ns for each in changes[1:]), None]
        broken = [(each, end) for each, end in zip(changes, ends, strict=True) if not each.is_met]
        if broken:
            yield Finding(
                kind="not_as_expected",
                rank=3,
                says="was not as expected {when}",
                name=topic,
                times_ns=tuple(each.stamp_ns for each, _ in broken),
                cause=broken[0][0].reason,
                away=tuple(
                    Downtime(topic, end - each.stamp_ns if end else None) for each, end in broken
                ),
            )


def _mismatched(topic: str, mismatches: dict[Mismatch, int]) -> Finding:
    is_type = any(each.policy == "type" for each in mismatches)
    what = f"Types on {topic} differ" if is_type else f"QoS on {topic} is incompatible"
    nodes = (node for each in mismatches for node in (*each.subscribers, *each.publishers))
    return Finding(
        kind="incompatible_type" if is_type else "incompatible_qos",
        rank=4,
        says=f"{what}, so messages are lost, from {{at}} on",
        times_ns=(min(mismatches.values()),),
        cause="; ".join(dict.fromkeys(map(str, mismatches))),
        hit=tuple(dict.fromkeys(nodes)),
    )


def _reported(timeline: Timeline, known: Collection[str]) -> Iterator[Finding]:
    """Find what rclcpp and rclpy report, where the graph was not recorded."""
    found: dict[str, list[tuple[int, re.Match[str]]]] = {}
    for at_ns, text in timeline.lines.qos_reports():
        report = _REPORT.search(text)
        # rclpy reports the name that the node was given: without its namespace.
        if report and not any(topic.endswith(report["topic"]) for topic in known):
            found.setdefault(report["topic"], []).append((at_ns, report))
    for topic, reports in found.items():
        by_side: dict[str, dict[str, None]] = {"publisher": {}, "subscription": {}}
        for _, report in reports:
            by_side[report["other"]][f"/{report['logger'].replace('.', '/')}"] = None
        # The node that discovered a publisher has the subscription.
        subscribers, publishers = by_side["publisher"], by_side["subscription"]
        policies = {report["policy"].removesuffix("_QOS_POLICY").lower() for _, report in reports}
        sides = [f"{', '.join(subscribers)} requests more than is offered"] if subscribers else []
        sides += [f"{', '.join(publishers)} offers less than is requested"] if publishers else []
        yield Finding(
            kind="incompatible_qos",
            rank=4,
            says=f"QoS on {topic} is incompatible, so messages are lost, from {{at}} on",
            times_ns=(reports[0][0],),
            cause=f"{', '.join(sorted(policies))}: {'; '.join(sides)}; {_ORDER}",
            hit=tuple(subscribers | publishers),
        )


def _disconnected(timeline: Timeline) -> Iterator[Finding]:
    """Find what a failure left without its publisher or subscription for more than a moment."""
    found: dict[tuple[str, bool], list[tuple[Lack, Failure]]] = {}
    for lack in timeline.connections.lacks:
        for failure in timeline.failures:
            failed = {failure.name, *failure.hit}
            is_near = any(abs(lack.begin_ns - at) < _NEAR for at in failure.times)
            if is_near and failed.issuperset(lack.before) and lack.before:
                found.setdefault((failure.key, lack.of_publisher), []).append((lack, failure))
                break
    for (key, of_publisher), every in found.items():
        lacks, failure = [lack for lack, _ in every], every[0][1]
        missing = "publisher" if of_publisher else "subscription"
        lasted = [each.end_ns - each.begin_ns for each in lacks if each.end_ns]
        how_long = "until the end"
        if len(lasted) == len(lacks):
            how_long = f"for {duration(max(lasted))}"
        others = dict.fromkeys(node for each in lacks for node in each.others)
        yield Finding(
            kind="disconnected",
            rank=6,
            is_failure=False,
            says=f"left {listed([each.topic for each in lacks], _MANY)} without a {missing} "
            f"{how_long}, from {{at}} on",
            name=failure.name,
            key=key,
            times_ns=(min(each.begin_ns for each in lacks),),
            place=DeclaredPlace(container=failure.container),
            hit=tuple(others),
        )


def _unpublished(timeline: Timeline) -> Iterator[Finding]:
    """Find subscriptions that never had a publisher; some node may have another name for it."""
    endpoints = list(timeline.connections.endpoints)
    lacks = timeline.connections.lacks
    never = [each for each in lacks if each.of_publisher and not each.before and not each.end_ns]
    others: list[str] = []
    for number, lack in enumerate(never):
        # Further ones would take long, and are not listed.
        guesses = endpoints if number < _MOST_GUESSES else []
        meant = similar_topic(lack.topic, guesses, unused=True)
        if not meant:
            like = similar_topic(lack.topic, guesses, unused=False)
            hint = f", did you mean {like}?" if like else ""
            others.append(f"{lack.topic} ({listed(lack.others, _MANY)}{hint})")
            continue
        publishers = {each.node for each in endpoints if each.topic == meant and each.is_publisher}
        yield Finding(
            kind="misnamed_topic",
            rank=4,
            says=f"{listed(lack.others, _MANY)} subscribed to {lack.topic}, which had no publisher "
            "until the end, from {at} on",
            times_ns=(lack.begin_ns,),
            cause=f"did you mean {meant}? It has the same type, "
            f"{listed(sorted(publishers), _MANY)} publishes it, and nothing subscribes to it",
            hit=lack.others,
        )
    if others:
        yield Finding(
            kind="unpublished",
            rank=7,
            is_failure=False,
            says="Subscriptions had no publisher until the end, the first from {at} on",
            times_ns=(min(each.begin_ns for each in never),),
            cause=listed(others, _MANY),
        )
