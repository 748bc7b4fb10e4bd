"""``ros2cli.daemon``: calls are not printed any more.

The daemon's output goes to /dev/null unless it was started for debugging, but the arguments and
results were put into words for it all the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import ModuleType


def apply(module: ModuleType) -> None:
    """Replace what prints a call."""
    if not callable(module.pretty_print_call):
        raise TypeError("pretty_print_call is no function")
    module.pretty_print_call = say_nothing  # type: ignore[attr-defined]


def say_nothing(function: object, *arguments: object, **named: object) -> None:
    """Take what the printing function takes."""
