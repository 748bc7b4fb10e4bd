"""What to say where the kernel refuses something about a group. Pure: errors in, texts out."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING, Final, assert_never

from play_launch.process.cgroups.base import READ_ONLY_FIX, SCOPE_FIX
from play_launch.process.cgroups.controllers import VERSION_2_FIX, Lack, switched_on

if TYPE_CHECKING:
    from pathlib import Path

_KEYS: Final = {
    "cpu": "cpu_max and cpu_weight",
    "cpuset": "cpuset",
    "io": "io_weight",
    "memory": "memory_high and memory_max",
    "pids": "pids_max",
}
"""What does not hold without a controller."""
_DROP_IN: Final = (
    "Delegate=cpu cpuset io memory pids in a drop-in of user@.service (systemctl edit "
    "user@.service), or in the unit of play-launch"
)
_FILES: Final = {
    "io.weight": "the kernel has no cost model for disks (CONFIG_BLK_CGROUP_IOCOST)",
    "cpu.max": "the kernel has no CPU bandwidth control (CONFIG_CFS_BANDWIDTH)",
    "memory.max": "the memory controller is not there",
}


def unavailable_controller(controller: str, group: Path, lack: Lack) -> str:
    """Say that a group has not got a controller."""
    what = f"{_cannot_hold(controller)}is not available in {group}: "
    match lack:
        case Lack.IN_VERSION_1:
            return f"{what}version 1 of control groups uses it; fix: {VERSION_2_FIX}"
        case Lack.SWITCHED_OFF:
            return f"{what}it is switched off in the kernel; fix: {switched_on(controller)}"
        case Lack.NOT_GIVEN:
            return f"{what}it is not delegated, or the kernel has none; fix: {_DROP_IN}"
    assert_never(lack)


def _cannot_hold(controller: str) -> str:
    return f"{_KEYS.get(controller, controller)} cannot hold: the controller {controller} "


def no_controller(controller: str, group: Path, error: OSError) -> str:
    """Say that a controller cannot be enabled below a group."""
    what = _cannot_hold(controller)
    match error.errno:
        case errno.ENOENT:
            return unavailable_controller(controller, group, Lack.NOT_GIVEN)
        case errno.EBUSY:
            return f"{what}cannot be enabled in {group}, which has processes; fix: {SCOPE_FIX}"
        case errno.EACCES | errno.EPERM:
            return f"{what}cannot be enabled in {group} by this user; fix: {_DROP_IN}"
        case errno.EROFS:
            return f"{what}cannot be enabled in {group}, which is read-only; fix: {READ_ONLY_FIX}"
        case errno.EOPNOTSUPP:
            return f"{what}cannot be enabled in {group}, which is threaded; fix: another base_path"
        case errno.EINVAL if controller == "cpu":
            return (
                f"{what}cannot be enabled in {group}: with CONFIG_RT_GROUP_SCHED the kernel "
                "refuses it while real-time processes are in other groups than the root; fix: a "
                "kernel without that option, or with rt_group_sched=0"
            )
    return f"{what}cannot be enabled in {group}: {os.strerror(error.errno or 0)}"


def no_group(group: Path, error: OSError) -> str:
    """Say that a group cannot be made."""
    why = os.strerror(error.errno or 0)
    match error.errno:
        case errno.EACCES | errno.EPERM:
            fix = SCOPE_FIX
        case errno.EROFS:
            fix = READ_ONLY_FIX
        case errno.EAGAIN:
            fix = "a larger cgroup.max.descendants in a group above"
        case _:
            fix = "another base_path, or cgroups: {enabled: false}"
    return f"the control group {group} cannot be made: {why}; fix: {fix}"


def no_limit(file: str, value: str, error: OSError) -> str:
    """Say that a limit cannot be written."""
    what = f"{file} cannot be set to {value}"
    match error.errno:
        case errno.ENOENT:
            why = _FILES.get(file, f"the kernel has no {file}")
            return f"{what}: {why}; fix: leave {_key(file)} out on this machine"
        case errno.EACCES | errno.EPERM:
            return f"{what}: it belongs to another user; fix: {SCOPE_FIX}"
    fix = f"another {_key(file)}"
    return f"{what}: {os.strerror(error.errno or 0)}; fix: {fix}"


def fewer_cpus(wanted: str, there: str) -> str:
    """Say that a cpuset names CPUs that are not there; `there`: which are."""
    return (
        f"cpuset {wanted} has CPUs that this machine, or the group above, has not: there are "
        f"{there}; fix: name those"
    )


def no_entry(base: Path, group: Path) -> str:
    """Say that processes of ours cannot enter groups, as we are elsewhere."""
    return (
        f"processes cannot enter groups below {base}: that takes the right to write to "
        f"{group / 'cgroup.procs'}, the nearest group above them and play-launch; fix: start "
        f"play-launch inside of {base}, or {SCOPE_FIX}"
    )


def _key(file: str) -> str:
    return file.replace("cpuset.cpus", "cpuset").replace(".", "_")
