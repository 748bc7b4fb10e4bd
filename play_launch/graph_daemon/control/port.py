"""Takes the daemon's port; the bound socket is the sign that one is the daemon.

``SO_REUSEADDR`` is not used. It would not help against what ros2cli's daemon leaves behind, whose
sockets lack it, and without it two of us can never both believe to have the port.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
import time
from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.contract import BACKLOG
from play_launch.graph_daemon.control.sockets import time_wait_ports

if TYPE_CHECKING:
    from play_launch.graph_daemon.contract import DaemonAddress

_IP_LOCAL_PORT_RANGE: Final = 51
"""See ip(7); Python has no name for it."""
_FIRST_PAUSE: Final = 0.02
_LONGEST_PAUSE: Final = 0.16
"""Seconds between two attempts; each looks at the sockets of all processes."""
_ASSASSINATION: Final = 0.005
"""Seconds that the exchange of three packets over loopback is given."""


class PortBusyError(OSError):
    """Somebody listens on the daemon's port, or the kernel keeps it."""

    def __init__(self, address: DaemonAddress) -> None:
        super().__init__(errno.EADDRINUSE, f"{address.host}:{address.port} is in use")


def listen(address: DaemonAddress) -> socket.socket:
    """Return a socket that listens at ``address``.

    Raises ``PortBusyError`` when the port is taken, other ``OSError`` where it cannot be had at
    all.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.bind((address.host, address.port))
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise PortBusyError(address) from None
        raise
    return listener


def listen_within(address: DaemonAddress, seconds: float) -> socket.socket:
    """Try to `listen` for some time, freeing the port of closed connections.

    Raises as `listen` does, when the time is over.
    """
    deadline = time.monotonic() + seconds
    pause = _FIRST_PAUSE
    while True:
        try:
            return listen(address)
        except PortBusyError:
            if time.monotonic() > deadline:
                raise
            if not end_time_wait(address):
                time.sleep(pause)
                pause = min(2 * pause, _LONGEST_PAUSE)


def end_time_wait(address: DaemonAddress) -> int:
    """End what closed connections leave at the port for a minute; returns how many there were.

    The side of a TCP connection that closes first keeps the pair of ports in TIME_WAIT, so that
    late packets find nobody new. On loopback no packet is late. A new attempt to connect from the
    peer's port is answered there with an acknowledgement that fits no attempt, the kernel resets
    that, and the reset ends the TIME_WAIT (RFC 1337 calls it an assassination; the setting
    net.ipv4.tcp_rfc1337 prevents it, and then one has to wait).
    """
    ports = time_wait_ports(address.port)
    for port in ports:
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_INET, socket.SOCK_STREAM) as peer,
        ):
            _use_port(peer, address.host, port)
            peer.settimeout(_ASSASSINATION)
            peer.connect((address.host, address.port))
    return len(ports)


def _use_port(peer: socket.socket, host: str, port: int) -> None:
    """Let a socket connect from a port, also where other connections use that port, too."""
    try:
        # The port is chosen when the other end is known, out of a range of one (Linux 6.3).
        range_of_one = struct.pack("=HH", port, port)
        peer.setsockopt(socket.IPPROTO_IP, _IP_LOCAL_PORT_RANGE, range_of_one)
    except OSError:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        peer.bind((host, port))
