"""What the kernel and whoever started us let us do. Nothing is changed."""

from __future__ import annotations

import ctypes
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.doctor.facts import GroupFacts, KeySupport
from play_launch.doctor.surroundings import Surroundings, surroundings_of
from play_launch.process.cgroups.base import (
    GroupError,
    facts_of,
    obstacle,
    own_base,
    own_hierarchy,
)
from play_launch.process.cgroups.controllers import lacks

if TYPE_CHECKING:
    from collections.abc import Callable

_OWN_GROUPS: Final = Path("/proc/self/cgroup")
_CONTROLLERS: Final = Path("/proc/cgroups")
_CPUS: Final = Path("/proc/cpuinfo")
_REAL_TIME: Final = Path("/proc/sys/kernel")


def surroundings() -> Surroundings:
    """Find out what started us."""
    return surroundings_of(
        _text(_OWN_GROUPS),
        docker=Path("/.dockerenv").exists(),
        podman=Path("/run/.containerenv").exists(),
    )


def own_group() -> GroupFacts:
    """Look at the control group below which those of a session would be made."""
    try:
        found = own_hierarchy()
    except GroupError as error:
        return GroupFacts(problem=str(error))
    base = own_base(found.own)
    return GroupFacts(
        folder=str(base),
        controllers=tuple(_text(base / "cgroup.controllers").split()),
        lacks=lacks(_text(_CONTROLLERS)),
        problem=obstacle(base, facts_of(base, found.mount)),
    )


def key_support() -> KeySupport:
    """Ask CPU and kernel for protection keys, and for one on trial."""
    found = re.search(r"^(?:flags|Features)\s*:(.*)$", _text(_CPUS), re.MULTILINE)
    return support_of(set(found[1].split()) if found else set(), trial=_has_key)


def support_of(flags: set[str], trial: Callable[[], bool]) -> KeySupport:
    """Conclude from the CPU's flags, and from a trial where that makes sense."""
    if not flags & {"pku", "poe"}:
        return KeySupport.NO_CPU
    if "pku" in flags and "ospke" not in flags:
        return KeySupport.NO_KERNEL
    return KeySupport.USABLE if trial() else KeySupport.REFUSED


def _has_key() -> bool:
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, "pkey_alloc"):
        return False
    key: int = library.pkey_alloc(0, 0)
    if key < 0:
        return False
    library.pkey_free(key)
    return True


def real_time_share() -> float | None:
    """Read which part of a second is left to real-time threads, see sched(7)."""
    with suppress(ValueError, ZeroDivisionError):
        runtime = int(_text(_REAL_TIME / "sched_rt_runtime_us"))
        period = int(_text(_REAL_TIME / "sched_rt_period_us"))
        return None if runtime < 0 else runtime / period
    return None


def _text(path: Path) -> str:
    with suppress(OSError):
        return path.read_text(encoding="utf-8", errors="replace")
    return ""
