"""What a system needs of its unit: limits, rights, time to stop. Pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.dependency import DependencyGraph
from play_launch.config.resources import IoClass, nice_limit
from play_launch.process.stop import StopPolicy

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.config.model import ReplayConfig
    from play_launch.config.resources import Resources

_HIGHEST_PRIORITY: Final = 99
_LOWEST_NICE: Final = -20
_FILES: Final = 4096
"""Open files of the supervisor of a large system."""
_MOST_FILES: Final = 524_288
"""The hard limit that systemd gives by itself."""
_CLOSING: Final = 10.0
"""Seconds to clean up after the last process and to close the recording."""
_SMALL_BY_DEFAULT: Final = ("memlock", "msgqueue", "nproc", "sigpending")
"""Hard limits that systemd, or the kernel, sets by itself; all others are unlimited."""


class Setting(NamedTuple):
    """Lines of a unit, and a comment above them that says why; either may be empty."""

    why: str
    lines: tuple[str, ...] = ()


def stop_seconds(config: ReplayConfig) -> int:
    """Give the seconds that an orderly stop takes at most.

    Members stop after those that depend on them, and each goes through all levels.
    """
    limits = config.stop
    each = limits.ask + limits.sigint + limits.sigterm + StopPolicy().sigkill
    return math.ceil(_generations(config) * each + _CLOSING)


def _generations(config: ReplayConfig) -> int:
    """Count the members that are stopped one after the other, at most."""
    before = DependencyGraph(config.start_rules, config.units).stopped_after()
    left = set(before)
    count = 0
    while left:
        now = {member for member in left if not before[member] & left}
        left -= now or left
        count += 1
    return max(count, 1)


def settings(config: ReplayConfig, *, for_user: bool) -> tuple[Setting, ...]:
    """Give the limits and rights that the configuration asks for.

    Args:
        config: The system.
        for_user: Whether the unit is one of a user's own manager, which can give no right.
    """
    return tuple(_settings(config, list(_asked(config)), for_user=for_user))


def _asked(config: ReplayConfig) -> Iterator[Resources]:
    for container in config.containers:
        yield container.resources
        yield from (node.resources for node in container.composable_nodes)
    yield from (process.resources for process in config.nodes)


def _settings(config: ReplayConfig, asked: list[Resources], *, for_user: bool) -> Iterator[Setting]:
    hard = _hard_limits(asked)
    files = max(_MOST_FILES, hard.pop("nofile", 0))
    yield Setting(
        "The supervisor has some ten files open for each process.",
        (f"LimitNOFILE={_FILES}:{_number(files)}",),
    )
    yield Setting(
        "Threads of DDS count as tasks, and a large system has thousands.", ("TasksMax=infinity",)
    )
    raised = list(_raised(config, asked, hard))
    if not for_user and not any("LimitRTPRIO" in line for each in raised for line in each.lines):
        yield Setting(
            "The supervisor goes before what it starts and stops, for that long.",
            ("LimitRTPRIO=1",),
        )
    if raised and for_user:
        raised.insert(
            0,
            Setting(
                "A user's manager cannot give more than it has: `systemctl edit user@.service` as "
                "root, with\nthe next Limit lines in its [Service], then a new login."
            ),
        )
    yield from raised
    yield from _rights(asked, for_user=for_user)


def _raised(
    config: ReplayConfig, asked: list[Resources], hard: dict[str, float]
) -> Iterator[Setting]:
    priorities = [each.scheduler.priority for each in asked if each.scheduler is not None]
    priority = max([0, *priorities, hard.pop("rtprio", 0)])
    if priority:
        above = min(int(priority) + 1, _HIGHEST_PRIORITY)
        yield Setting(
            f"Real-time priorities up to {priority:g}; threads of a container that watch over its "
            "nodes run one above.",
            (f"LimitRTPRIO={above}",),
        )
    nice = [each.nice for each in asked if each.nice is not None]
    lowest = min([0, *nice, nice_limit(int(hard.pop("nice", nice_limit(0))))])
    if lowest < 0:
        yield Setting(
            f"Nice values down to {lowest}; threads that watch over such nodes have one less.",
            (f"LimitNICE={max(lowest - 1, _LOWEST_NICE)}",),
        )
    if any(each.lock_memory for each in asked):
        hard["memlock"] = math.inf
    if names := [name for name in _SMALL_BY_DEFAULT if name in hard]:
        yield Setting(
            "Hard limits that leave room for what `resources` asks for.",
            tuple(f"Limit{name.upper()}=infinity" for name in names),
        )
    if any(container.core_dumps for container in config.containers):
        yield Setting("`core_dumps` of a container.", ("LimitCORE=infinity",))


def _rights(asked: list[Resources], *, for_user: bool) -> Iterator[Setting]:
    if any(each.io_priority and each.io_priority.io_class is IoClass.REALTIME for each in asked):
        if for_user:
            yield Setting(
                "`io_priority: realtime` takes CAP_SYS_NICE, which only a system service can have."
            )
        else:
            yield Setting(
                "`io_priority: realtime` takes it; every process of the system has it then.",
                ("AmbientCapabilities=CAP_SYS_NICE",),
            )
    score = min([0, *(each.oom_score_adj for each in asked if each.oom_score_adj is not None)])
    if score < 0 and for_user:
        yield Setting(
            f"`oom_score_adj: {score}` takes CAP_SYS_RESOURCE, or a system service with "
            f"OOMScoreAdjust={score}."
        )
    elif score < 0:
        yield Setting(
            f"`oom_score_adj: {score}`: processes may raise it and not lower it. Give the others "
            "one of their own,\nor they have this one.",
            (f"OOMScoreAdjust={score}",),
        )


def _hard_limits(asked: list[Resources]) -> dict[str, float]:
    found: dict[str, float] = {}
    for resources in asked:
        for limit in resources.rlimits:
            found[limit.name] = max(found.get(limit.name, 0), limit.hard)
    return found


def _number(limit: float) -> str:
    return "infinity" if math.isinf(limit) else f"{limit:.0f}"
