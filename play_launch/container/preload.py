"""What the dynamic linker loads into a process before all else (``LD_PRELOAD``, see ld.so(8))."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Final

from play_launch.ros.fastdds.middleware import asks_for_fastdds

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

VARIABLE: Final = "LD_PRELOAD"
WAITS_SWITCH: Final = "PLAY_LAUNCH_FASTDDS_WAITS"
"""Environment variable: with 0 a process gets Fast DDS as it is."""
_WAITS_LIBRARY: Final = "libfastdds_waits.so"
"""Beside the container's program; which functions it has, and why: docs/overrides.md."""
_ASAN_OPTIONS: Final = "ASAN_OPTIONS"
_ANY_ORDER: Final = "verify_asan_link_order=0"
"""Else a program with GCC's AddressSanitizer refuses to start behind a preloaded library. Only what
defines functions that the sanitizer has, too, must not come before it."""


def preloaded_in(environment: Mapping[str, str]) -> list[str]:
    """Give what is preloaded, first things first, as it is written there."""
    return [name for name in re.split(r"[: ]", environment.get(VARIABLE, "")) if name]


def preloading(
    environment: Mapping[str, str], library: Path, *, last: bool = False
) -> dict[str, str]:
    """Add a library to what is preloaded, as the first one unless it may come last."""
    changed = dict(environment)
    entry = os.fspath(library)
    if " " in entry:
        # The name ends there, but a virtual environment may be in such a folder. A name without
        # a slash is searched for.
        searched = [os.fspath(library.parent), *filter(None, [changed.get("LD_LIBRARY_PATH")])]
        changed["LD_LIBRARY_PATH"] = os.pathsep.join(searched)
        entry = library.name
    names = [name for name in preloaded_in(changed) if name != entry]
    changed[VARIABLE] = ":".join([*names, entry] if last else [entry, *names])
    return changed


def with_safe_waits(environment: Mapping[str, str], container: Path) -> dict[str, str]:
    """Keep a process from waiting for itself in Fast DDS; ``container`` is our own program.

    With another middleware, or where the switch says so, nothing is changed.
    """
    if not asks_for_fastdds(environment) or environment.get(WAITS_SWITCH) == "0":
        return dict(environment)
    changed = preloading(environment, container.with_name(_WAITS_LIBRARY), last=True)
    others = changed.get(_ASAN_OPTIONS, "").removeprefix(_ANY_ORDER).removeprefix(":")
    changed[_ASAN_OPTIONS] = f"{_ANY_ORDER}:{others}" if others else _ANY_ORDER
    return changed
