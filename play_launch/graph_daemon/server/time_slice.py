"""The daemon's turns on a processor that many others want."""

from __future__ import annotations

import ctypes
import os
import struct
from typing import Final

SLICE: Final = 100_000
"""ns; the shortest that Linux gives."""
_SYSTEM_CALL: Final = {"x86_64": 314, "aarch64": 274}
"""The number of sched_setattr(2), which neither Python nor older C libraries have."""


def ask_for_short_turns() -> bool:
    """Have the calling thread, and those that it starts, run for a short time but soon.

    An answer takes less than a millisecond of processor time. Where sixty starting programs want
    two processors, whose turns are some milliseconds each, it waits for seconds. The scheduler of
    Linux 6.12 and later (EEVDF, "custom slice" in its sources) takes the one first whose turn would
    be over first, within what is everybody's due; it asks for no right, since nobody gets more.

    Returns:
        Whether the kernel has taken it. Older kernels take it and go on as before, or refuse.
    """
    machine = os.uname().machine
    if machine not in _SYSTEM_CALL or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return False
    # struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period.
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = struct.pack("=IIQiIQQQ", 48, os.SCHED_OTHER, 0, nice, 0, SLICE, 0, 0)
    call = ctypes.CDLL(None).syscall
    return bool(call(_SYSTEM_CALL[machine], 0, attributes, 0) == 0)
