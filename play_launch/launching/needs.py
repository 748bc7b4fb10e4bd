"""What a system needs of the machine, as its configuration says."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.model import ContainerType, Isolation
from play_launch.fastdds.middleware import asks_for_fastdds

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.config.model import ContainerConfig, ReplayConfig
    from play_launch.core.group_limits import GroupLimits


def is_own(container: ContainerConfig) -> bool:
    """Whether it runs our own program."""
    return not container.attach and container.container_type is not ContainerType.STOCK


def shares_memory(container: ContainerConfig) -> bool:
    """Whether its nodes are processes in its own memory."""
    return container.container_type.is_isolated and container.isolation is not Isolation.PROCESS


def has_stock_containers(config: ReplayConfig) -> bool:
    """Whether we have to speak ROS ourselves."""
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
