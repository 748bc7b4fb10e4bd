"""Configuration of play-launch's own participants: early discovery, and no harm to other processes.

**Over UDP.** A participant that listens in shared memory has all others open its queues there. Fast
DDS 2.14 checks a queue that is opened again within a third of a second by sleeping for a third of a
second (``SharedMemGlobal::Port::healthy_check``, ``healthy_check_timeout_ms`` is 1000): in its
thread of events, with a lock that publishers need. So each command that reads the parameters of a
node held up all nodes of a system for up to 0.33 s. The messages exchanged are small.

**Early.** They announce themselves every 0.2 s instead of every 3 s, and with LOCALHOST to the
first 63 participants of a domain instead of 32. The first announcement, which Fast DDS sends before
it can receive the answers, is withheld: existing participants answer the second one.

**With an end.** Where a participant is destroyed while one of its discovery callbacks runs, Fast
DDS of the ROS wheels may wait in a loop that keeps the mutex from that callback, for seconds or
for good, while rclpy holds Python's lock. The cause is a deadline that overflows. And where a
reader in shared memory exits amid a message, a writer may hang on its own lock. So the functions
that Fast DDS waits with are replaced in the library that is loaded (``fastdds/waits.cpp`` of the
container's sources).
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING, Final

from play_launch.config.substitutions import ament_prefixes
from play_launch.ros.fastdds.middleware import (
    PROFILE_VARIABLES,
    files_here,
    is_fastdds,
    profile_in_use,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
_RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_OLD_RANGE: Final = "ROS_LOCALHOST_ONLY"
_PEERS: Final = "ROS_STATIC_PEERS"
_UDP: Final = "UDPv4"
_ANY_RANGE: Final[dict[str, str | None]] = {_RANGE: "SYSTEM_DEFAULT", _OLD_RANGE: None}
_WAITS: Final = Path("lib") / "play_launch_container" / "libfastdds_waits.so"
_LIBRARIES: Final = ("libfastrtps.so", "libfastdds.so")
"""How the file of Fast DDS begins, of version 2 and later ones."""
_lock = threading.Lock()
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class OwnParticipant:
    """Settings of a participant of ours, and their reason."""

    transports: str
    """As a value of FASTDDS_BUILTIN_TRANSPORTS; empty where they are not our choice."""
    reason: str
    profile: bool = False
    """Whether it gets a profile of ours."""
    own_transport: bool = False
    """Whether that profile sets the transport: UDP alone."""
    on_loopback: bool = False
    """Whether that profile limits discovery to this machine, as LOCALHOST does."""


def decide(environment: Mapping[str, str], files: Iterable[str], rmw: str) -> OwnParticipant | None:
    """Decide how our participant discovers others; what the user has configured is kept.

    ``files`` are names in the working directory. Returns None with another middleware.
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
    if TRANSPORTS in environment and not only_here:
        return OwnParticipant(environment[TRANSPORTS], f"{TRANSPORTS} is set", profile=True)
    return OwnParticipant(
        _UDP, "no profile is set", profile=True, own_transport=True, on_loopback=only_here
    )


@contextlib.contextmanager
def as_our_own(environment: Mapping[str, str], rmw: str) -> Iterator[OwnParticipant | None]:
    """Configure the contexts and participants that are made in the block.

    Fast DDS reads profiles once, when a process makes its first participant, and rcl reads the
    range when a context is made; so this is to be around both, of each participant of a process.

    The variables are set past ``os.environ``, from which the environment of children is made.
    """
    chosen = decide(environment, files_here(), rmw)
    with _lock, contextlib.ExitStack() as until_made:
        if chosen is None or not chosen.profile:
            yield chosen
            return
        file = until_made.enter_context(NamedTemporaryFile("w", suffix=".xml", encoding="ascii"))
        file.write(_profile(chosen))
        file.flush()
        # With LOCALHOST rmw_fastrtps adds shared memory to whatever a profile says.
        variables: dict[str, str | None] = {_profile_variable(): file.name}
        if chosen.on_loopback:
            variables |= _ANY_RANGE
        until_made.callback(_set, {name: os.environ.get(name) for name in variables})
        _set(variables)
        yield chosen


def _set(variables: Mapping[str, str | None]) -> None:
    libc = ctypes.CDLL(None)
    for name, value in variables.items():
        if value is None:
            libc.unsetenv(name.encode())
        else:
            libc.setenv(name.encode(), os.fsencode(value), 1)


def end_participants_safely(libraries: tuple[str, ...] = _LIBRARIES) -> int:
    """Replace the waits in the libraries that are loaded, so after the middleware's.

    Does nothing with another middleware, and where our own library is not installed. Returns in how
    many it was done.
    """
    replace = _own_function("play_launch_replace_waits")
    return 0 if replace is None else sum(replace(os.fsencode(name)) for name in libraries)


@contextlib.contextmanager
def made_safely(chosen: OwnParticipant | None) -> Iterator[None]:
    """Make a participant in the block, by this thread, with our waits and announced after it.

    To be used once the middleware is loaded. Only where the transport is ours, the announcement is
    withheld.
    """
    end_participants_safely()
    withhold = _own_function("play_launch_withhold_datagrams")
    if withhold is None or chosen is None or not chosen.own_transport:
        yield
        return
    withhold(1)
    try:
        yield
    finally:
        withhold(0)


def _own_function(name: str) -> Callable[..., int] | None:
    """Find a function of our own library, which is loaded for it."""
    for prefix in (Path(sys.prefix), *ament_prefixes(os.environ)):
        path = prefix / _WAITS
        try:
            function: Callable[..., int] = getattr(ctypes.CDLL(os.fspath(path)), name)
        except (OSError, AttributeError) as error:  # AttributeError: it is of another version
            if path.exists():
                _log.debug("%s cannot be used: %s", path, error)
            continue
        return function
    return None


def _profile_variable() -> str:
    """Name the variable that the Fast DDS of this process reads: from version 3 on the new one."""
    new, old = PROFILE_VARIABLES
    return new if "/libfastdds.so" in Path("/proc/self/maps").read_text(encoding="utf-8") else old


def _profile(chosen: OwnParticipant) -> str:
    return _TEMPLATE.format(
        transport=_TRANSPORT if chosen.own_transport else "",
        use_transport=_USE_TRANSPORT if chosen.own_transport else "",
        peers=_LOOPBACK if chosen.on_loopback else "",
    )


_TRANSPORT: Final = """
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>play_launch_udp</transport_id>
        <type>UDPv4</type>
        <maxInitialPeersRange>63</maxInitialPeersRange>
        <receiveBufferSize>4194304</receiveBufferSize>
      </transport_descriptor>
    </transport_descriptors>"""
"""The 64th participant of domain 232 has no port; Fast DDS exits a process that computes it."""
_USE_TRANSPORT: Final = """
        <userTransports><transport_id>play_launch_udp</transport_id></userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>"""
_LOOPBACK: Final = """
          <metatrafficUnicastLocatorList><locator><udpv4/></locator></metatrafficUnicastLocatorList>
          <initialPeersList>
            <locator><udpv4><address>127.0.0.1</address></udpv4></locator>
          </initialPeersList>"""
"""A unicast locator without an address keeps Fast DDS from listening to multicast."""
_TEMPLATE: Final = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>{transport}
    <participant profile_name="play_launch" is_default_profile="true">
      <rtps>{use_transport}
        <builtin>
          <discovery_config>
            <leaseAnnouncement><nanosec>200000000</nanosec></leaseAnnouncement>
          </discovery_config>{peers}
        </builtin>
      </rtps>
    </participant>
  </profiles>
</dds>
"""
