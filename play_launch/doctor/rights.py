"""How a right is given, by what starts play-launch: the exact commands. Pure."""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING, Final

from play_launch.doctor.surroundings import Surroundings

if TYPE_CHECKING:
    from collections.abc import Mapping


class Right(Enum):
    """What somebody else has to allow."""

    REAL_TIME = auto()
    NICE = auto()
    LOCKED_MEMORY = auto()
    OPEN_FILES = auto()
    PROCESSES = auto()
    CONTROL_GROUPS = auto()
    """Groups below our own, with controllers."""
    CONTROLLERS = auto()
    """More controllers in there."""


_UNIT: Final = "in the [Service] of the unit (play-launch systemd-unit writes {which})"
_MANAGER: Final = (
    "systemctl edit user@.service, there [Service] {line}, a new login; and {line} in the "
    "[Service] of the unit"
)
_LIMITS_CONF: Final = '"<user> - {item}" in /etc/security/limits.conf, and a new login'


def _limit(name: str, value: str, item: str, container: str) -> dict[Surroundings, str]:
    line = f"Limit{name}={value}"
    return {
        Surroundings.LOGIN: _LIMITS_CONF.format(item=item),
        Surroundings.SYSTEM_SERVICE: f"{line} {_UNIT.format(which='it')}",
        Surroundings.USER_SERVICE: _MANAGER.format(line=line),
        Surroundings.DOCKER: f"docker run {container}",
        Surroundings.PODMAN: f"podman run {container}",
    }


_DELEGATED_TO_USERS: Final = (
    "systemctl edit user@.service, there [Service] Delegate=cpu cpuset io memory pids, a new login"
)
_GROUPS_OF_CONTAINERS: Final = {
    Surroundings.DOCKER: "docker run --security-opt writable-cgroups=true (from 28.0 on; before: "
    "--privileged)",
    Surroundings.PODMAN: "podman run --security-opt unmask=/sys/fs/cgroup",
}
_WAYS: Final[Mapping[Right, Mapping[Surroundings, str]]] = {
    Right.REAL_TIME: _limit("RTPRIO", "99", "rtprio 99", "--cap-add SYS_NICE --ulimit rtprio=99"),
    Right.NICE: _limit("NICE", "-20", "nice -20", "--cap-add SYS_NICE"),
    Right.LOCKED_MEMORY: _limit(
        "MEMLOCK", "infinity", "memlock unlimited", "--ulimit memlock=-1:-1"
    ),
    Right.OPEN_FILES: _limit("NOFILE", "65536", "nofile 65536", "--ulimit nofile=65536:65536"),
    Right.PROCESSES: _limit("NPROC", "infinity", "nproc unlimited", "--ulimit nproc=-1:-1"),
    Right.CONTROL_GROUPS: {
        Surroundings.LOGIN: "systemd-run --user --scope -p Delegate=yes play-launch replay ...",
        Surroundings.SYSTEM_SERVICE: f"Delegate=yes {_UNIT.format(which='it')}",
        Surroundings.USER_SERVICE: f"Delegate=yes {_UNIT.format(which='it with --user')}",
        **_GROUPS_OF_CONTAINERS,
    },
    Right.CONTROLLERS: {
        Surroundings.LOGIN: _DELEGATED_TO_USERS,
        Surroundings.SYSTEM_SERVICE: f"Delegate=yes {_UNIT.format(which='it')}",
        Surroundings.USER_SERVICE: _DELEGATED_TO_USERS,
        **_GROUPS_OF_CONTAINERS,
    },
}
_OUTSIDE: Final = (Surroundings.SYSTEM_SERVICE, Surroundings.USER_SERVICE)


def how_to_get(right: Right, surroundings: Surroundings, *, from_login: str = "") -> str:
    """Give the command or line; from a login also those for services, each on a line.

    ``from_login`` is what a login does, where more is known about it.
    """
    ways = _WAYS[right]
    if surroundings is not Surroundings.LOGIN:
        return ways[surroundings]
    here = from_login or ways[surroundings]
    return "\n".join([here, *(f"as a {each}: {ways[each]}" for each in _OUTSIDE)])
