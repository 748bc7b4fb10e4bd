"""Who sends a SIGKILL that nobody here sent: the kernel for want of memory, or some process.

The kernel does not keep who sent it. It counts whom its out-of-memory killer ended, on the whole
machine (``oom_kill`` in ``/proc/vmstat``), and how long processes waited for memory
(``/proc/pressure/memory``, see the kernel's documentation on PSI).
"""

from __future__ import annotations

import os
import re
from typing import Final

_COUNTERS: Final = "/proc/vmstat"
_PRESSURE: Final = "/proc/pressure/memory"
_OOM_KILLS: Final = re.compile(r"^oom_kill (\d+)$", re.MULTILINE)
_WAITED: Final = re.compile(r"^some avg10=([\d.]+)", re.MULTILINE)
_MUCH: Final = 10.0
"""Percent of the last ten seconds; daemons that watch memory act from here on, or later."""
_MOST: Final = 65536
"""Bytes; neither is longer."""


def oom_kills() -> int | None:
    """Count the processes of this machine that the kernel has ended for want of memory.

    None: it does not say (before Linux 4.13, or `/proc` is restricted).
    """
    found = _OOM_KILLS.search(_text(_COUNTERS))
    return None if found is None else int(found[1])


def memory_pressure() -> float | None:
    """Give the share of the last ten seconds in which some process waited for memory, in percent.

    None: the kernel does not measure it.
    """
    found = _WAITED.search(_text(_PRESSURE))
    return None if found is None else float(found[1])


def killer_hint(before: int | None, now: int | None, pressure: float | None) -> str:
    """Say who may have sent a SIGKILL; empty: nothing is known.

    Args:
        before: `oom_kills` when the process began. What was killed since may be somebody else,
            long ago, or in a control group with a limit of its own: the count does not say.
        now: The same at its end.
        pressure: `memory_pressure` at its end.
    """
    if before is None or now is None:
        return ""
    waited = ""
    if pressure is not None and pressure >= _MUCH:
        waited = f"; processes waited for memory in {pressure:.0f} % of the last 10 s"
    if now == before:
        who_else = ", at which systemd-oomd or earlyoom may kill" if waited else ""
        return f"sent by a process, not by the kernel for want of memory{waited}{who_else}"
    whom = "a process" if now == before + 1 else f"{now - before} processes"
    return (
        f"the kernel killed {whom} of this machine for want of memory while it ran, perhaps this "
        f"one{waited}; fix: look in the kernel's log (journalctl -k -g 'Killed process'), and give "
        "whatever takes the memory a memory_max"
    )


def _text(path: str) -> str:
    """Read a file; the kernel answers from memory, so this does not block."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        return ""
    try:
        return os.read(descriptor, _MOST).decode("ascii", errors="replace")
    except OSError:
        return ""
    finally:
        os.close(descriptor)
