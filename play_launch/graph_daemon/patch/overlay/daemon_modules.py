"""``ros2cli.daemon`` and ``ros2cli.node.network_aware``: less work for each call.

Upstream puts each call into words even where they are not printed, and lists all interfaces before
each call, and once more before each attribute.
"""

from __future__ import annotations

import functools
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import ModuleType

INTERVAL = 30.0
"""Seconds between two checks of the addresses; a change of them is noticed that much later."""

_NEXT = "_play_launch_next_check"


def apply(module: ModuleType) -> None:
    if module.__name__ == "ros2cli.daemon":
        if not callable(module.pretty_print_call):
            raise TypeError("pretty_print_call is no function")
        module.pretty_print_call = print_nothing  # type: ignore[attr-defined]
    else:
        check_seldom(module.NetworkAwareNode)


def print_nothing(function: object, *arguments: object, **named: object) -> None:
    """Accept the arguments of the printing function."""


def check_seldom(aware: Any) -> None:
    """Let the class check the addresses at most every ``INTERVAL`` seconds."""
    check = aware.reset_if_addresses_changed

    @functools.wraps(check)
    def reset_if_addresses_changed(self: Any) -> None:
        # In the dictionary: the class passes on unknown attributes to its node, by way of this
        # very method.
        own = self.__dict__
        now = time.monotonic()
        if now < own.get(_NEXT, now):
            return
        check(self)
        # Only now: a check that failed is repeated by the next call, as upstream does.
        own[_NEXT] = now + INTERVAL

    aware.reset_if_addresses_changed = reset_if_addresses_changed
