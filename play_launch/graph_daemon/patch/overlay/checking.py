"""``ros2cli.node.network_aware``: the network's addresses are looked at now and then only.

Upstream lists all interfaces before each call, and once more before each attribute.
"""

from __future__ import annotations

import functools
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import ModuleType

INTERVAL = 30.0
"""Seconds between two looks at the addresses; a change of them is noticed that much later."""

_NEXT = "_play_launch_next_look"


def apply(module: ModuleType) -> None:
    """Let the class look at most every ``INTERVAL`` seconds."""
    aware = module.NetworkAwareNode
    look = aware.reset_if_addresses_changed

    @functools.wraps(look)
    def reset_if_addresses_changed(self: Any) -> None:
        # In the dictionary: the class passes on unknown attributes to its node, by way of this
        # very method.
        own = self.__dict__
        now = time.monotonic()
        if now < own.get(_NEXT, now):
            return
        look(self)
        # Only now: a look that failed is repeated by the next call, as upstream does.
        own[_NEXT] = now + INTERVAL

    aware.reset_if_addresses_changed = reset_if_addresses_changed
