"""What a configuration requires of the machine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.model import ContainerType, Isolation
from play_launch.ros.fastdds.middleware import asks_for_fastdds

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.config.group_limits import CpuMax, GroupLimits
    from play_launch.config.model import ContainerConfig, ReplayConfig


def is_own(container: ContainerConfig) -> bool:
    """Whether it runs our own program."""
    return not container.attach and container.container_type is not ContainerType.STOCK


def shares_memory(container: ContainerConfig) -> bool:
    """Whether its nodes are processes in its own memory."""
    return container.container_type.is_isolated and container.isolation is not Isolation.PROCESS


def has_stock_containers(config: ReplayConfig) -> bool:
    """Whether the supervisor needs ROS itself."""
    return any(each.container_type is ContainerType.STOCK for each in config.containers)


def uses_fastdds(config: ReplayConfig, environment: Mapping[str, str]) -> bool:
    """Whether any process asks for Fast DDS; ``environment`` is what they inherit."""
    declared = (
        *(each.environment for each in config.containers),
        *(each.environment for each in config.nodes),
    )
    return any(asks_for_fastdds({**environment, **each}) for each in declared)


def participants(config: ReplayConfig) -> int:
    """Count the participants of DDS, if each process is one.

    A node with memory of its own is one of its own; the others share their container's.
    """
    processes = len(config.containers) + len(config.nodes)
    apart = (
        each
        for each in config.containers
        if each.container_type.is_isolated and not shares_memory(each)
    )
    return processes + sum(len(each.composable_nodes) for each in apart)


def group_limits(config: ReplayConfig) -> Iterator[GroupLimits]:
    """Give what control groups are to limit, of all that is started here."""
    for container in config.containers:
        yield container.resources.group
        yield from (node.resources.group for node in container.composable_nodes)
    yield from (process.resources.group for process in config.nodes)


def wants_groups(config: ReplayConfig) -> bool:
    """Whether processes are to have control groups."""
    if config.cgroups.enabled is not None:
        return config.cgroups.enabled
    return any(group_limits(config))


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
