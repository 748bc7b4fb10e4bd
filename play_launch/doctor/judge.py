"""From all facts to the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.doctor.judge_rights import judge_rights
from play_launch.doctor.judge_ros import judge_container, judge_python, judge_ros
from play_launch.doctor.judge_system import (
    judge_kernel,
    judge_limits,
    judge_network,
    judge_recording,
    judge_shared_memory,
)

if TYPE_CHECKING:
    from play_launch.doctor.facts import MachineFacts
    from play_launch.doctor.finding import Finding


def judge(facts: MachineFacts) -> list[Finding]:
    """Judge a machine; the order is that of the report."""
    return [
        *judge_python(facts.python),
        *judge_ros(facts.ros),
        *judge_container(facts.container, facts.python.packages.get("play-launch-py", "")),
        *judge_kernel(facts.kernel),
        *judge_limits(facts.limits, facts.surroundings),
        *judge_rights(facts),
        *judge_shared_memory(facts.shared_memory, facts.ros.rmw_in_use),
        *judge_network(facts.network, facts.ros.rmw_in_use),
        *judge_recording(facts.recording),
    ]
