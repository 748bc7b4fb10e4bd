"""The addresses of this machine, and when they change, as the kernel reports by rtnetlink(7).

A DDS participant uses the interfaces that it found when it was made. Asking for them again and
again takes as long as an answer; the kernel reports by itself when one comes or goes.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
from typing import TYPE_CHECKING, Final, NamedTuple

import psutil

if TYPE_CHECKING:
    from collections.abc import Callable

SETTLING: Final = 1.0
"""Seconds without a message in which addresses are taken to have settled."""

_IPV4_CHANGES: Final = 0x10
_IPV6_CHANGES: Final = 0x100
_READ: Final = 64 * 1024


class InterfaceAddress(NamedTuple):
    """One address of one interface; both change their owner over time."""

    interface: str
    address: str


def addresses() -> frozenset[InterfaceAddress]:
    """List the IP addresses of this network namespace, but for link-local ones.

    Those are good on one link only, and every container of Docker's brings some. Raises
    ``OSError`` where the kernel does not list them.
    """
    return frozenset(
        InterfaceAddress(interface, found.address)
        for interface, all_of_it in psutil.net_if_addrs().items()
        for found in all_of_it
        if found.family in {socket.AF_INET, socket.AF_INET6}
        and not ipaddress.ip_address(found.address).is_link_local
    )


class InterfaceWatch:
    """Calls ``on_change``, in the loop's thread, when the addresses are others than before.

    Raises ``OSError`` where the kernel does not report them.
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
