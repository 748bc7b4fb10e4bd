"""Starts and stops the daemon of a domain, whoever has its port at the moment."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.contract import IDLE_TIMEOUT, WARM
from play_launch.graph_daemon.control.background import StartError, spawn
from play_launch.graph_daemon.control.port import PortBusyError, listen_within
from play_launch.graph_daemon.control.takeover import (
    STOP_LIMIT,
    Action,
    Kind,
    Occupant,
    PortHeldError,
    decide,
    end,
    look,
)
from play_launch.graph_daemon.settings import compared_settings

if TYPE_CHECKING:
    import socket
    import subprocess
    from collections.abc import Mapping

    from play_launch.graph_daemon.contract import DaemonAddress

_ATTEMPTS: Final = 5
"""Any command of ros2cli that runs while nobody has the port starts its daemon there."""
_BRIEFLY: Final = 0.5


@dataclass(frozen=True, slots=True)
class Started:
    """What came of a start."""

    started: bool
    """False when a daemon of ours ran already."""
    pid: int
    messages: tuple[str, ...]
    """What a person should know, a line each: whom it took over from, which settings differ."""
    process: subprocess.Popen[bytes] | None = None
    """The process that was started. Who lives longer than it must wait for it; who ends earlier
    need not, then somebody else does."""

    def let_go(self) -> None:
        """Leave the process to itself, without Python's warning that it was forgotten."""
        if self.process is not None:
            self.process.returncode = 0


@dataclass(frozen=True, slots=True)
class Port:
    """The port as it was come by: the socket, or the pid of our daemon that has it."""

    listener: socket.socket | None
    pid: int
    messages: tuple[str, ...]


def acquire(
    address: DaemonAddress, *, restart: bool = False, environment: Mapping[str, str] = os.environ
) -> Port:
    """Take the port, from another daemon if need be.

    Args:
        address: Where.
        restart: Whether a daemon of ours that runs is replaced.
        environment: The caller's, to compare with the settings of one that is kept.

    Raises ``PortHeldError`` where it belongs to something else, other ``OSError`` where the port
    cannot be had at all.
    """
    messages: tuple[str, ...] = ()
    for _ in range(_ATTEMPTS):
        occupant = look(address)
        decision = decide(occupant, compared_settings(environment), restart=restart)
        match decision.action:
            case Action.KEEP:
                return Port(None, occupant.status["pid"], (*messages, *decision.messages))
            case Action.REFUSE:
                raise PortHeldError("\n".join(decision.messages))
            case Action.ASK_TO_END | Action.KILL:
                end(address, occupant)
                messages += decision.messages
            case Action.START:
                pass
        try:
            limit = STOP_LIMIT if occupant.kind is Kind.NOBODY else _BRIEFLY
            return Port(listen_within(address, limit), 0, messages)
        except PortBusyError:
            if occupant.kind is Kind.NOBODY and look(address).kind is Kind.NOBODY:
                raise PortHeldError(
                    f"nobody listens on port {address.port}, but it stays in use: closed "
                    "connections keep it for a minute (TIME_WAIT); try again then"
                ) from None
            # Somebody was faster.
            continue
    raise PortHeldError(f"port {address.port} is taken again and again while a daemon is started")


def start_daemon(
    address: DaemonAddress,
    *,
    idle_timeout: float = IDLE_TIMEOUT,
    wait_for: str = WARM,
    restart: bool = False,
    environment: Mapping[str, str] = os.environ,
) -> Started:
    """Start a daemon in the background, unless one of ours runs.

    Args:
        address: Where.
        idle_timeout: Seconds without a request after which it ends; 0 for never.
        wait_for: What to wait for: `LISTENING` or `WARM`.
        restart: Whether a running one is replaced.
        environment: For the daemon's process.

    Raises ``PortHeldError``, ``StartError`` and ``OSError``, with texts for a person.
    """
    port = acquire(address, restart=restart, environment=environment)
    if port.listener is None:
        return Started(started=False, pid=port.pid, messages=port.messages)
    with port.listener as listener:
        process = spawn(
            address,
            listener,
            idle_timeout=idle_timeout,
            wait_for=wait_for,
            environment=environment,
        )
    return Started(started=True, pid=process.pid, messages=port.messages, process=process)


def stop_daemon(address: DaemonAddress) -> Occupant:
    """End the daemon of a domain, ours or ros2cli's; returns who it was.

    Raises ``PortHeldError`` as `end` does.
    """
    occupant = look(address)
    end(address, occupant)
    return occupant


__all__ = [
    "Port",
    "PortHeldError",
    "StartError",
    "Started",
    "acquire",
    "start_daemon",
    "stop_daemon",
]
