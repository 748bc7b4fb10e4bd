"""All checks, in the order of the report."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from play_launch.doctor import machine, ros

if TYPE_CHECKING:
    from play_launch.doctor.finding import Finding


def examine() -> list[Finding]:
    """Run all checks; takes a second, most of it for starting two processes."""
    rmw, found = ros.ros()
    return [
        ros.python(),
        ros.packages(),
        *found,
        machine.kernel(),
        machine.proc(),
        machine.control_groups(),
        machine.protection_keys(),
        machine.address_space(),
        machine.open_files(),
        machine.processes(),
        machine.core_dumps(),
        machine.real_time(),
        machine.nice_values(),
        machine.locked_memory(),
        *machine.shared_memory(rmw),
        machine.loopback(os.environ),
        machine.discovery(os.environ, rmw),
        machine.domain(os.environ),
        machine.recordings(),
    ]
