"""Who has the daemon's port, and what is to be done about it."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import time
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TYPE_CHECKING, Any, Final

from play_launch.graph_daemon.client.graph_client import (
    BadReplyError,
    DaemonError,
    DaemonTimeoutError,
    GraphClient,
    NoDaemonError,
    RemoteError,
)
from play_launch.graph_daemon.contract import (
    DOMAIN_VARIABLE,
    GRAPH_METHODS,
    SHUTDOWN_METHOD,
    STATUS_METHOD,
)
from play_launch.graph_daemon.control.background import START_LIMIT
from play_launch.graph_daemon.control.port import PortBusyError, listen_within
from play_launch.graph_daemon.control.sockets import (
    Holder,
    age_of,
    environment_of,
    holder_of,
    is_stopped,
)
from play_launch.graph_daemon.settings import compared_settings, differences

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.graph_daemon.contract import DaemonAddress

PROBE_LIMIT: Final = 5.0
"""Seconds that whoever has the port is given for each of two questions. ros2cli's daemon answers
one client after the other, so under load it takes a while."""
STOP_LIMIT: Final = 10.0
"""Seconds until the port must be free after a daemon was asked to end; ros2cli's value."""
_KILL_AFTER: Final = 2.0
_STOPPED_AFTER: Final = 1.0
"""Seconds without an answer after which it is looked whether the process is stopped."""

_INCOMPARABLE: Final = (
    "the settings of the daemon cannot be compared with those here: its process belongs to "
    "another user, or is in another container"
)


class Kind(Enum):
    """Who has the port."""

    NOBODY = auto()
    OURS = auto()
    STOCK = auto()
    """ros2cli's daemon."""
    HUNG = auto()
    """One of the two, by its command line, that does not answer."""
    FOREIGN = auto()
    """Anything else."""


@dataclass(frozen=True, slots=True)
class Occupant:
    """Who has the port of a domain."""

    kind: Kind
    holder: Holder | None = None
    status: Mapping[str, Any] = field(default_factory=dict)
    """What our daemon reports, by the fields of `DaemonStatus`; empty for others. Where its process
    is of the same user, ``settings`` are those of its environment that discovery depends on."""
    problem: str = ""
    """Why it is foreign, or hung."""


class Action(Enum):
    """What a start has to do."""

    START = auto()
    KEEP = auto()
    """It runs already."""
    ASK_TO_END = auto()
    KILL = auto()
    REFUSE = auto()


@dataclass(frozen=True, slots=True)
class Decision:
    """What a start has to do, and what is to be reported."""

    action: Action
    messages: tuple[str, ...] = ()


class PortHeldError(Exception):
    """The port belongs to something that is no daemon, or does not become free."""


def decide(occupant: Occupant, caller: Mapping[str, str], *, restart: bool = False) -> Decision:
    """Decide what a start does about who has the port.

    ros2cli's daemon keeps nothing that would be lost, and its clients do not notice, so it is
    replaced; so is a daemon that hangs, because its clients would hang with it. Ours is kept, even
    with other settings than the caller's: somebody else may need it as it is.

    Args:
        occupant: Who has it.
        caller: The settings of the caller, as `compared_settings` returns them.
        restart: Whether a running daemon of ours is to be replaced.
    """
    match occupant.kind:
        case Kind.NOBODY:
            return Decision(Action.START)
        case Kind.STOCK:
            return Decision(
                Action.ASK_TO_END, (f"took over from ros2cli's daemon{_who(occupant)}",)
            )
        case Kind.HUNG:
            if occupant.holder is None or not occupant.holder.pid:
                return _refuse(occupant)
            return Decision(Action.KILL, (f"killed a daemon that hung{_who(occupant)}",))
        case Kind.OURS if restart:
            return Decision(Action.ASK_TO_END)
        case Kind.OURS:
            different = settings_warnings(occupant, caller)
            return Decision(Action.KEEP, different)
        case Kind.FOREIGN:
            return _refuse(occupant)


def settings_warnings(occupant: Occupant, caller: Mapping[str, str]) -> tuple[str, ...]:
    """Say where a daemon of ours was started with other settings than the caller has."""
    if occupant.kind is not Kind.OURS:
        return ()
    settings = occupant.status.get("settings")
    if not isinstance(settings, dict):
        return (_INCOMPARABLE,)
    daemon = {str(name): str(value) for name, value in settings.items()}
    return tuple(differences(daemon, caller))


def look(address: DaemonAddress, limit: float = PROBE_LIMIT) -> Occupant:
    """Find out who has the port.

    Takes twice ``limit`` seconds at most; while a daemon has just been started, and does not
    answer yet, `START_LIMIT` more.
    """
    client = GraphClient(address, limit)
    try:
        methods = _methods(address, client)
    except NoDaemonError:
        return Occupant(Kind.NOBODY)
    except DaemonTimeoutError as error:
        holder = holder_of(address.port)
        if holder is None:
            return Occupant(Kind.NOBODY)
        if not holder.is_daemon:
            return Occupant(Kind.FOREIGN, holder, problem=str(error))
        if _is_stopped(holder):
            problem = "its process is stopped, by SIGSTOP or a debugger"
            return Occupant(Kind.HUNG, holder, problem=problem)
        if age_of(holder.pid) < START_LIMIT:
            # It may still be loading ROS.
            return look(address, limit)
        return Occupant(Kind.HUNG, holder, problem=str(error))
    except DaemonError as error:
        return Occupant(Kind.FOREIGN, holder_of(address.port), problem=str(error))
    holder = holder_of(address.port)
    wanted = {GRAPH_METHODS[0], SHUTDOWN_METHOD}
    if not isinstance(methods, list) or not wanted <= {str(method) for method in methods}:
        return Occupant(Kind.FOREIGN, holder, problem="it has other methods than the daemon")
    try:
        status = json.loads(str(client.call(STATUS_METHOD)))
    except NoDaemonError:
        return Occupant(Kind.NOBODY)
    except (RemoteError, BadReplyError, ValueError):
        return Occupant(Kind.STOCK, holder)
    except DaemonTimeoutError as error:
        return Occupant(Kind.HUNG, holder, problem=str(error))
    except DaemonError as error:
        return Occupant(Kind.FOREIGN, holder, problem=str(error))
    if not isinstance(status, dict) or not isinstance(status.get("pid"), int):
        return Occupant(Kind.FOREIGN, holder, problem="its status is none of a graph daemon")
    if holder is not None and holder.pid == status["pid"]:
        # They may hold passwords: the kernel gives them to the same user only.
        environment = environment_of(holder.pid)
        if environment is not None:
            environment[DOMAIN_VARIABLE] = str(address.domain)
            status["settings"] = compared_settings(environment, str(status.get("rmw", "")))
    return Occupant(Kind.OURS, holder, status)


def _methods(address: DaemonAddress, client: GraphClient) -> object:
    """Ask for its methods; a daemon that is stopped is not given the full time."""
    try:
        return GraphClient(address, _STOPPED_AFTER).call("system.listMethods")
    except DaemonTimeoutError:
        if _is_stopped(holder_of(address.port)):
            raise
    return client.call("system.listMethods")


def _is_stopped(holder: Holder | None) -> bool:
    return holder is not None and holder.pid > 0 and is_stopped(holder.pid)


def end(address: DaemonAddress, occupant: Occupant, limit: float = STOP_LIMIT) -> None:
    """Ask a daemon to end, or kill it if it hangs, and wait until the port is free.

    Raises ``PortHeldError`` when it does not become free, or when the occupant is no daemon.
    """
    if occupant.kind is Kind.NOBODY:
        return
    if occupant.kind is Kind.FOREIGN:
        raise PortHeldError(_held(occupant))
    pid = occupant.holder.pid if occupant.holder else 0
    descriptor = _open(pid)
    try:
        if occupant.kind is Kind.HUNG:
            _kill(descriptor)
        else:
            # It may end before it has answered.
            with contextlib.suppress(DaemonError):
                GraphClient(address, limit).call(SHUTDOWN_METHOD)
        try:
            listen_within(address, limit).close()
        except PortBusyError:
            message = f"port {address.port} did not become free within {limit:g} s{_who(occupant)}"
            raise PortHeldError(message) from None
        _gone(descriptor, limit)
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _open(pid: int) -> int | None:
    if not pid:
        return None
    try:
        return os.pidfd_open(pid)
    except OSError:
        return None


def _kill(descriptor: int | None) -> None:
    if descriptor is None:
        return
    with contextlib.suppress(OSError):
        signal.pidfd_send_signal(descriptor, signal.SIGTERM)
        if not _gone(descriptor, _KILL_AFTER):
            signal.pidfd_send_signal(descriptor, signal.SIGKILL)


def _gone(descriptor: int | None, limit: float) -> bool:
    """Wait for the end of a process; whether it came."""
    if descriptor is None:
        return True
    deadline = time.monotonic() + limit
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(max(0.0, deadline - time.monotonic()) * 1000))


def _refuse(occupant: Occupant) -> Decision:
    return Decision(Action.REFUSE, (_held(occupant),))


def _held(occupant: Occupant) -> str:
    who = str(occupant.holder) if occupant.holder else "something"
    return f"{who} has the daemon's port: {occupant.problem}"


def _who(occupant: Occupant) -> str:
    return f" (pid {occupant.holder.pid})" if occupant.holder and occupant.holder.pid else ""
