"""How participants of play-launch itself meet those of the system: soon, and without harm to them.

**Over UDP.** A participant that listens in shared memory has all others open its queues there. Fast
DDS 2.14 checks a queue that is opened again within a third of a second by sleeping for a third of a
second (``SharedMemGlobal::Port::healthy_check``, ``healthy_check_timeout_ms`` is 1000): in its
thread of events, with a lock that publishers need. So each command that looked at the
parameters of a node held up all nodes of a system for up to 0.33 s. What we exchange is small.

**Soon.** For recipients and times of announcements, see `announcements`.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
from dataclasses import dataclass
from enum import Enum, auto
from functools import cache
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING, Final

from play_launch.ros.fastdds.announcements import Announcements, profile
from play_launch.ros.fastdds.middleware import is_fastdds
from play_launch.ros.fastdds.profiles import files_here, profile_in_use

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
_PROFILE: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
_RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_OLD_RANGE: Final = "ROS_LOCALHOST_ONLY"
_PEERS: Final = "ROS_STATIC_PEERS"
_UDP: Final = "UDPv4"
_ANY_RANGE: Final[dict[str, str | None]] = {_RANGE: "SYSTEM_DEFAULT", _OLD_RANGE: None}
_lock = threading.Lock()


class Reach(Enum):
    """Recipients of the announcements that play-launch sends itself."""

    THIS_MACHINE = auto()
    NETWORKS = auto()
    DEFAULT = auto()
    """Fast DDS does it."""


@dataclass(frozen=True, slots=True)
class OwnParticipant:
    """What is set for a participant of ours while it is made, and why."""

    transports: str
    """As a value of FASTDDS_BUILTIN_TRANSPORTS; empty where they are not our choice."""
    reason: str
    profile: bool = False
    """Whether it gets a profile of ours."""
    reach: Reach = Reach.DEFAULT


def decide(environment: Mapping[str, str], files: Iterable[str], rmw: str) -> OwnParticipant | None:
    """Decide how our participant meets others. What the user has configured is left alone.

    Args:
        environment: That of the process.
        files: Names of the files in its working directory.
        rmw: The middleware in use.

    Returns:
        None with another middleware, whose transports are its own business.
    """
    if not is_fastdds(rmw):
        return None
    profile = profile_in_use(environment, files)
    if profile is not None:
        return OwnParticipant(environment.get(TRANSPORTS, ""), profile)
    only_here = environment.get(_RANGE) == "LOCALHOST" or environment.get(_OLD_RANGE) == "1"
    if environment.get(_PEERS) or environment.get(_RANGE) == "OFF":
        transports = "" if only_here else environment.get(TRANSPORTS, "")
        return OwnParticipant(transports, "its peers are configured", profile=True)
    if only_here:
        # With LOCALHOST itself rmw_fastrtps adds shared memory to whatever a profile says.
        return OwnParticipant(_UDP, "no profile is set", profile=True, reach=Reach.THIS_MACHINE)
    if TRANSPORTS in environment:
        return OwnParticipant(environment[TRANSPORTS], f"{TRANSPORTS} is set", profile=True)
    return OwnParticipant(_UDP, "no profile is set", profile=True, reach=Reach.NETWORKS)


@contextlib.contextmanager
def as_our_own(environment: Mapping[str, str], rmw: str) -> Iterator[OwnParticipant | None]:
    """Contexts and participants that are made in the block meet others as it is decided here.

    Fast DDS reads profiles once, when a process makes its first participant, and rcl reads the
    range when a context is made; so this is to be around both, of each participant of a process.

    The variables are set past ``os.environ``: children are started with what stands there, and must
    not get ours.

    Args:
        environment: That of this process.
        rmw: The middleware in use.
    """
    chosen = decide(environment, files_here(), rmw)
    with _lock, contextlib.ExitStack() as until_made:
        if chosen is None or not chosen.profile:
            yield chosen
            return
        ours, here = chosen.reach is not Reach.DEFAULT, chosen.reach is Reach.THIS_MACHINE
        port = None
        if ours:
            announcements = _announcements(on_loopback=here)
            until_made.enter_context(announcements.held())
            port = announcements.port
        file = until_made.enter_context(NamedTemporaryFile("w", suffix=".xml", encoding="ascii"))
        file.write(profile(port, own_transport=ours, on_loopback=here))
        file.flush()
        # With another range rmw_fastrtps announces, too.
        variables: dict[str, str | None] = {_PROFILE: file.name, **(_ANY_RANGE if ours else {})}
        until_made.callback(_set, {name: os.environ.get(name) for name in variables})
        _set(variables)
        yield chosen


@cache
def _announcements(*, on_loopback: bool) -> Announcements:
    return Announcements(on_loopback=on_loopback)


def _set(variables: Mapping[str, str | None]) -> None:
    libc = ctypes.CDLL(None)
    for name, value in variables.items():
        if value is None:
            libc.unsetenv(name.encode())
        else:
            libc.setenv(name.encode(), os.fsencode(value), 1)
