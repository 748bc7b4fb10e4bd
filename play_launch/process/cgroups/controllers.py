"""Cause of a missing controller: not delegated, used by version 1, or switched off."""

from __future__ import annotations

from contextlib import suppress
from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

_TABLE: Final = Path("/proc/cgroups")
_OLD_NAMES: Final = {"blkio": "io"}
VERSION_2_FIX: Final = (
    "boot with the kernel's parameter systemd.unified_cgroup_hierarchy=1, or cgroup_no_v1=all"
)


class Lack(Enum):
    """Cause of a missing controller."""

    NOT_GIVEN = auto()
    """The groups above do not pass it on, as far as is known."""
    IN_VERSION_1 = auto()
    """A hierarchy of version 1."""
    SWITCHED_OFF = auto()
    """By a parameter of the kernel."""


def lacks(table: str) -> Mapping[str, Lack]:
    """Read ``/proc/cgroups``, by names of version 2.

    One that is not listed there may be available all the same: newer kernels leave some out.
    """
    found: dict[str, Lack] = {}
    for line in table.splitlines():
        match line.split():
            case [name, hierarchy, _, enabled] if hierarchy.isdigit():
                controller = _OLD_NAMES.get(name, name)
                if enabled == "0":
                    found[controller] = Lack.SWITCHED_OFF
                elif hierarchy != "0":
                    found[controller] = Lack.IN_VERSION_1
    return found


def lack_of(controller: str) -> Lack:
    """Return why this machine does not have a controller."""
    text = ""
    with suppress(OSError):
        text = _TABLE.read_text(encoding="utf-8", errors="replace")
    return lacks(text).get(controller, Lack.NOT_GIVEN)


def switched_on(controller: str) -> str:
    """Give the fix for one that is switched off."""
    return (
        f"boot without the kernel's parameter cgroup_disable={controller} (Raspberry Pi OS: with "
        f"cgroup_enable={controller})"
    )
