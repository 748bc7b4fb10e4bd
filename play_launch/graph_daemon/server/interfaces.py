"""The addresses of this machine, and when they change, as the kernel tells by rtnetlink(7).

A DDS participant uses the interfaces that it found when it was made. Asking for them again and
again costs as much as an answer; the kernel says by itself when one comes or goes.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

SETTLING: Final = 1.0
"""Seconds without a message in which addresses are taken to have settled."""

_HEADER: Final = struct.Struct("=IHHII")
"""nlmsghdr: length, type, flags, sequence, port."""
_ADDRESS: Final = struct.Struct("=BBBBI")
"""ifaddrmsg: family, prefix, flags, scope, index of the interface."""
_ATTRIBUTE: Final = struct.Struct("=HH")
"""rtattr: length, type."""
_DONE: Final = 3
_ERROR: Final = 2
_NEW_ADDRESS: Final = 20
_GET_ADDRESS: Final = 22
_DUMP_REQUEST: Final = 0x301
_IPV4_CHANGES: Final = 0x10
_IPV6_CHANGES: Final = 0x100
_OF_LINK: Final = 253
"""Scope of addresses that are good on one link only; every container brings some."""
_PEER_OR_OWN: Final = 1
_OWN: Final = 2
_READ: Final = 64 * 1024


class InterfaceAddress(NamedTuple):
    """One address of one interface; both change their owner over time."""

    interface: int
    family: int
    address: bytes


class NetlinkError(OSError):
    """The kernel did not list the addresses."""


def parse_addresses(data: bytes) -> tuple[set[InterfaceAddress], bool]:
    """Read messages of a list of addresses; returns those found and whether the list is over.

    Raises ``NetlinkError`` when the kernel reports an error, or for what are no such messages.
    """
    found: set[InterfaceAddress] = set()
    while data:
        if len(data) < _HEADER.size:
            raise NetlinkError("a netlink message is cut off")
        length, kind, _, _, _ = _HEADER.unpack_from(data)
        if not _HEADER.size <= length <= len(data):
            raise NetlinkError("a netlink message has a wrong length")
        if kind == _DONE:
            return found, True
        if kind == _ERROR:
            raise NetlinkError("the kernel refuses to list addresses")
        if kind == _NEW_ADDRESS:
            address = _parse_address(data[_HEADER.size : length])
            if address is not None:
                found.add(address)
        data = data[_aligned(length) :]
    return found, False


def _parse_address(data: bytes) -> InterfaceAddress | None:
    if len(data) < _ADDRESS.size:
        raise NetlinkError("an address is cut off")
    family, _, _, scope, index = _ADDRESS.unpack_from(data)
    if scope == _OF_LINK:
        return None
    attributes: dict[int, bytes] = {}
    rest = data[_ADDRESS.size :]
    while len(rest) >= _ATTRIBUTE.size:
        length, kind = _ATTRIBUTE.unpack_from(rest)
        if not _ATTRIBUTE.size <= length <= len(rest):
            raise NetlinkError("an attribute of an address has a wrong length")
        attributes[kind] = rest[_ATTRIBUTE.size : length]
        rest = rest[_aligned(length) :]
    # On a point-to-point link the first is the other end's.
    address = attributes.get(_OWN) or attributes.get(_PEER_OR_OWN)
    return None if address is None else InterfaceAddress(index, family, address)


def _aligned(length: int) -> int:
    return (length + 3) & ~3


def addresses() -> frozenset[InterfaceAddress]:
    """List the addresses of this network namespace, but for link-local ones.

    Raises ``OSError`` where the kernel does not tell.
    """
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
        netlink.settimeout(1.0)
        request = _HEADER.pack(_HEADER.size + _ADDRESS.size, _GET_ADDRESS, _DUMP_REQUEST, 1, 0)
        netlink.send(request + _ADDRESS.pack(socket.AF_UNSPEC, 0, 0, 0, 0))
        found: set[InterfaceAddress] = set()
        over = False
        while not over:
            more, over = parse_addresses(netlink.recv(_READ))
            found |= more
        return frozenset(found)


class InterfaceWatch:
    """Calls ``on_change``, in the loop's thread, when the addresses are others than before.

    Raises ``OSError`` where the kernel does not tell.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._on_change = on_change
        self._timer: asyncio.TimerHandle | None = None
        self._socket = socket.socket(
            socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.NETLINK_ROUTE
        )
        try:
            self._socket.bind((0, _IPV4_CHANGES | _IPV6_CHANGES))
            # After the subscription, so that nothing falls between.
            self._known = addresses()
        except OSError:
            self._socket.close()
            raise
        self._loop.add_reader(self._socket, self._on_message)

    def close(self) -> None:
        """Watch no more."""
        self._loop.remove_reader(self._socket)
        self._socket.close()
        if self._timer is not None:
            self._timer.cancel()

    def _on_message(self) -> None:
        # What it says does not matter, nor whether some were lost: the list is read anew.
        with contextlib.suppress(OSError):
            while self._socket.recv(_READ):
                pass
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_later(SETTLING, self._compare)

    def _compare(self) -> None:
        try:
            now = addresses()
        except OSError:
            self._timer = self._loop.call_later(SETTLING, self._compare)
            return
        if now != self._known:
            self._known = now
            self._on_change()
