"""Which limits of nodes can stall others: those of a container share locks.

A node that the kernel does not let run keeps the locks that it holds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.launching.needs import shares_memory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.config.model import ContainerConfig
    from play_launch.core.group_limits import CpuMax

_STALLING_PERCENT: Final = 20
"""Of a CPU. A node that gets less is held back for most of each period."""
_STALLING_RATIO: Final = 1000
"""Of weights. The lighter one gets a slice of some milliseconds every few seconds."""
_USUAL_WEIGHT: Final = 100


def stalls(container: ContainerConfig) -> Iterator[tuple[str, str]]:
    """Give the nodes that can stall others, each with what happens then and the fix."""
    if not shares_memory(container):
        return
    nodes = container.composable_nodes
    heaviest = max([_USUAL_WEIGHT, *(node.resources.group.cpu_weight or 0 for node in nodes)])
    locks = f"keeps the locks that it shares with the other nodes of {container.full_name}"
    for node in nodes:
        limit, weight = node.resources.group.cpu_max, node.resources.group.cpu_weight
        if limit is not None and limit.percent < _STALLING_PERCENT:
            yield node.declared_full_name, _by_quota(limit, locks)
        if weight is not None and heaviest >= _STALLING_RATIO * weight:
            yield node.declared_full_name, _by_weight(weight, heaviest, locks)


def _by_quota(limit: CpuMax, locks: str) -> str:
    return (
        f"cpu_max gives it {limit.percent:.3g} % of a CPU: while it is held back it {locks} "
        f"(allocator, middleware), which wait for up to {(limit.period - limit.quota) / 1000:.0f} "
        'ms; fix: a shorter period such as "1000 10000", cpu_weight instead, or a container of its '
        "own"
    )


def _by_weight(weight: int, heaviest: int, locks: str) -> str:
    return (
        f"cpu_weight {weight} beside {heaviest} lets it wait for seconds where the CPUs are busy: "
        f"meanwhile it {locks} (allocator, middleware), which may be taken for frozen; fix: "
        f"cpu_weight {-(-heaviest // 100)} or more, or a container of its own"
    )
