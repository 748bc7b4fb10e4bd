"""From a declared node to the request that loads it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.install.command import remap_rules
from play_launch.wire.messages import Load

if TYPE_CHECKING:
    from play_launch.config.model import ComposableNodeConfig

_SEVERITIES: Final = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
"""``rcl_interfaces/Log``."""


def load_request(config: ComposableNodeConfig, attempt: int, entry: tuple[str, ...] = ()) -> Load:
    """Make the request; names that were not given stay empty, so the component keeps its own.

    `entry` is how its process enters its control group.
    """
    return Load(
        attempt=attempt,
        package_name=config.package,
        plugin_name=config.plugin,
        node_name=config.name,
        node_namespace=config.namespace,
        log_level=_SEVERITIES[config.log_level.lower()] if config.log_level else 0,
        remap_rules=remap_rules(config.remappings),
        parameters=config.parameters,
        extra_arguments=config.extra_arguments,
        resources=(*entry, *config.resources.settings()),
        lock_memory=config.resources.lock_memory,
    )
