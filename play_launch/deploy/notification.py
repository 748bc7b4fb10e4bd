"""Service manager that started play-launch: the protocol of sd_notify(3)."""

from __future__ import annotations

import os
import socket
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import MutableMapping


class ServiceManager:
    """Datagram socket of the service manager: a path, or ``@`` and an abstract name."""

    def __init__(self, address: str, watchdog: float | None = None) -> None:
        self.watchdog = watchdog
        """Seconds without a message after which the service is killed; None: no watchdog."""
        self._address = f"\0{address[1:]}" if address.startswith("@") else address

    def notify(self, *assignments: str) -> bool:
        """Send one message of lines such as ``READY=1``; False if it was not accepted."""
        message = "\n".join(assignments).encode(errors="replace")
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
                ours.setblocking(False)
                return ours.sendto(message, self._address) == len(message)
        except OSError:
            return False


def claim(environ: MutableMapping[str, str]) -> ServiceManager | None:
    """Return the service manager, and remove it from the environment that children inherit."""
    address = environ.pop("NOTIFY_SOCKET", "")
    interval, watched = environ.pop("WATCHDOG_USEC", ""), environ.pop("WATCHDOG_PID", "")
    if not address.startswith(("/", "@")):
        return None  # none of the other kinds is on this machine
    seconds: float | None = None
    if interval.isascii() and interval.isdecimal() and watched in {"", str(os.getpid())}:
        seconds = int(interval) / 1_000_000 or None
    return ServiceManager(address, seconds)
