"""Topics whose publishers offer less than subscriptions request, as rclcpp and rclpy report it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from play_launch.postmortem.findings import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.timeline import Timeline

_REPORT: Final = re.compile(
    r"\[(?P<logger>[^\]\s]+)\]: New (?P<other>publisher|subscription) discovered on topic "
    r"'(?P<topic>[^']+)', (?:offer|request)ing incompatible QoS\..*"
    r"incompatible policy: (?P<policy>\w+)",
    re.DOTALL,
)
_ORDER: Final = "a publisher has to offer as much as is requested (reliable, transient_local)"


def detect(timeline: Timeline) -> Iterator[Finding]:
    found: dict[str, list[tuple[int, re.Match[str]]]] = {}
    for at_ns, text in timeline.lines.qos_reports():
        if report := _REPORT.search(text):
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
