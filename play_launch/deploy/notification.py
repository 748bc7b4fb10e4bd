"""What a service says to the service manager that started it: the protocol of sd_notify(3)."""

from __future__ import annotations

import os
import socket
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import MutableMapping

ADDRESS: Final = "NOTIFY_SOCKET"
_WATCHDOG: Final = "WATCHDOG_USEC"
_WATCHED: Final = "WATCHDOG_PID"
_MICROSECONDS: Final = 1_000_000


class ServiceManager:
    """Whoever started us and wants to hear how it goes."""

    def __init__(self, address: str, watchdog: float | None = None) -> None:
        """Take the address of its datagram socket: a path, or ``@`` and an abstract name.

        ``watchdog`` is the seconds after which it ends a service that it does not hear of; None:
        it does not.
        """
        self.watchdog = watchdog
        self._address = f"\0{address[1:]}" if address.startswith("@") else address

    def notify(self, *assignments: str) -> bool:
        """Send one message of lines such as ``READY=1``; False when it was not taken."""
        message = "\n".join(assignments).encode(errors="replace")
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
                # A manager that is busy, or stopped, is nothing that a robot waits for.
                ours.setblocking(False)
                return ours.sendto(message, self._address) == len(message)
        except OSError:
            return False


def claim(environ: MutableMapping[str, str]) -> ServiceManager | None:
    """Find the service manager, and take it out of the environment: it is not our children's.

    None where there is none, or it is not us that it watches over.
    """
    address = environ.pop(ADDRESS, "")
    interval, watched = environ.pop(_WATCHDOG, ""), environ.pop(_WATCHED, "")
    if not address.startswith(("/", "@")):
        return None  # of the other kinds, none is of this machine
    seconds: float | None = None
    if interval.isascii() and interval.isdecimal() and watched in {"", str(os.getpid())}:
        seconds = int(interval) / _MICROSECONDS or None
    return ServiceManager(address, seconds)
