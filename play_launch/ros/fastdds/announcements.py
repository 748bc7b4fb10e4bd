"""Passes the announcements of our participants on, once they can hear the answers.

Fast DDS 2.14 announces a new participant before it takes what it receives: the receivers are
registered last (``RTPSParticipantImpl::enable``). An answer within that millisecond is lost,
and does not answer again: both meet when the other one announces itself, every 3 s
(``leaseAnnouncement``). On two cores that was so more often than not. So ours announce themselves
to a socket of this process. It forwards that to the addresses of Fast DDS, but not while a
participant is made.

Where announcements go to is fixed by RTPS 2.2, 9.6.1.1 (ports) and 9.6.1.4 (the multicast group).
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from typing import TYPE_CHECKING, Final

import psutil

if TYPE_CHECKING:
    from collections.abc import Iterator

_GROUP: Final = "239.255.0.1"
_LOOPBACK: Final = "127.0.0.1"
_BASE: Final = 7400
_PER_DOMAIN: Final = 250
_FIRST: Final = 10
_PARTICIPANTS: Final = 120
"""So many have ports in the range of a domain; with LOCALHOST rmw_fastrtps announces to 32."""
_PORTS: Final = 65536
"""Of the last domain, 232, not all participants have one."""
_LONGEST: Final = 65536
_LOOK_AT_INTERFACES: Final = 2.0
"""Seconds after which the addresses of this machine are looked at again."""

_HEADER: Final = 20
_DATA: Final = 0x15
_INLINE_QOS: Final = 0x02
_PID_SENTINEL: Final = 0x01
_PID_METATRAFFIC: Final = 0x32
"""Where a participant listens to announcements; in Fast DDS 2.14 these name no domain."""


class Announcements:
    """Where the participants of this process announce themselves, for its whole life.

    Args:
        on_loopback: Whether they are announced to this machine alone, as LOCALHOST asks for, else
            to the multicast group on all networks.
    """

    def __init__(self, *, on_loopback: bool) -> None:
        self._on_loopback = on_loopback
        self._inbox = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._inbox.bind((_LOOPBACK, 0))
        self._free = threading.Event()
        self._free.set()
        self._sockets: list[socket.socket] = []
        self._looked = -_LOOK_AT_INTERFACES
        threading.Thread(target=self._run, name="announcements", daemon=True).start()

    @property
    def port(self) -> int:
        """The UDP port, of 127.0.0.1, to announce to."""
        return int(self._inbox.getsockname()[1])

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """What comes while the block runs is passed on at its end."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()

    def _run(self) -> None:
        while True:
            announcement = self._inbox.recv(_LONGEST)
            self._free.wait()
            domain = domain_of(announcement)
            if domain is not None:
                self._pass_on(announcement, domain)

    def _pass_on(self, announcement: bytes, domain: int) -> None:
        first = _BASE + _PER_DOMAIN * domain
        if self._on_loopback:
            begin = first + _FIRST
            for port in range(begin, min(begin + 2 * _PARTICIPANTS, _PORTS), 2):
                with contextlib.suppress(OSError):
                    self._inbox.sendto(announcement, (_LOOPBACK, port))
            return
        for sender in self._senders():
            # A network may be gone, or have no route for multicast.
            with contextlib.suppress(OSError):
                sender.sendto(announcement, (_GROUP, first))

    def _senders(self) -> list[socket.socket]:
        """Return a socket for each address of this machine."""
        now = time.monotonic()
        if now - self._looked > _LOOK_AT_INTERFACES:
            self._looked = now
            for sender in self._sockets:
                sender.close()
            self._sockets = [_sender(address) for address in sorted(_addresses())]
        return self._sockets


def domain_of(announcement: bytes) -> int | None:
    """Return the domain of a participant's announcement, by the port that it names.

    None for other messages, and with a port that is no participant's.
    """
    found = None
    with contextlib.suppress(struct.error, IndexError):
        if announcement[:4] != b"RTPS":
            return None
        place = _HEADER
        while place + 4 <= len(announcement):
            kind, flags = announcement[place], announcement[place + 1]
            order = "<" if flags & 1 else ">"
            (length,) = struct.unpack_from(f"{order}H", announcement, place + 2)
            if kind == _DATA and not flags & _INLINE_QOS:
                (to_payload,) = struct.unpack_from(f"{order}H", announcement, place + 6)
                # The payload begins with a header of 4 octets, and is of that order.
                found = _domain_named(announcement, place + 8 + to_payload + 4, order)
            if not length:
                break
            place += 4 + length
    return found


def _domain_named(message: bytes, place: int, order: str) -> int | None:
    while True:
        name, length = struct.unpack_from(f"{order}HH", message, place)
        if name == _PID_SENTINEL:
            return None
        if name == _PID_METATRAFFIC:
            # A locator: its kind, the port, 16 octets of an address.
            (port,) = struct.unpack_from(f"{order}I", message, place + 8)
            domain, offset = divmod(port - _BASE, _PER_DOMAIN)
            return domain if _BASE <= port < _PORTS and offset >= _FIRST else None
        place += 4 + length


def _addresses() -> set[str]:
    found = psutil.net_if_addrs().values()
    return {each.address for of_one in found for each in of_one if each.family == socket.AF_INET}


def _sender(address: str) -> socket.socket:
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with contextlib.suppress(OSError):
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
    return sender


def profile(announce_to: int | None, *, own_transport: bool, on_loopback: bool) -> str:
    """Write a profile of Fast DDS for participants that announce themselves every 0.2 s.

    Args:
        announce_to: UDP port of 127.0.0.1, None for the default of Fast DDS.
        own_transport: Whether it has UDP and nothing else.
        on_loopback: Whether it listens to no multicast.
    """
    return _PROFILE.format(
        transport=_TRANSPORT if own_transport else "",
        use_transport=_USE_TRANSPORT if own_transport else "",
        # One without an address keeps Fast DDS from listening to multicast.
        listen=_LISTEN if on_loopback else "",
        announce="" if announce_to is None else _ANNOUNCE.format(port=announce_to),
    )


_TRANSPORT: Final = """
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>play_launch_udp</transport_id>
        <type>UDPv4</type>
        <maxInitialPeersRange>32</maxInitialPeersRange>
      </transport_descriptor>
    </transport_descriptors>"""
_USE_TRANSPORT: Final = """
        <userTransports><transport_id>play_launch_udp</transport_id></userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>"""
_LISTEN: Final = """
          <metatrafficUnicastLocatorList><locator><udpv4/></locator></metatrafficUnicastLocatorList>"""
_ANNOUNCE: Final = """
          <initialPeersList>
            <locator><udpv4><address>127.0.0.1</address><port>{port}</port></udpv4></locator>
          </initialPeersList>"""
_PROFILE: Final = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>{transport}
    <participant profile_name="play_launch" is_default_profile="true">
      <rtps>{use_transport}
        <builtin>
          <discovery_config>
            <leaseAnnouncement><nanosec>200000000</nanosec></leaseAnnouncement>
          </discovery_config>{listen}{announce}
        </builtin>
      </rtps>
    </participant>
  </profiles>
</dds>
"""
