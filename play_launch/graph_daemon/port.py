"""The daemon's port: which process owns it, and how it is acquired.

A daemon of ours keeps the port, ros2cli's daemon is asked to end, any other process is named. The
bound socket is the lock: ``SO_REUSEADDR`` is not used, so two daemons can never both have the port.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import time
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TYPE_CHECKING, Any, Final

import psutil

from play_launch import UserError
from play_launch.graph_daemon.contract import (
    BACKLOG,
    DOMAIN_VARIABLE,
    NODE_PREFIX,
    SHUTDOWN_METHOD,
    STATUS_METHOD,
)
from play_launch.graph_daemon.graph_client import (
    DaemonError,
    GraphClient,
    NoDaemonError,
    RemoteError,
)
from play_launch.ros.fastdds.middleware import PROFILE_VARIABLES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.graph_daemon.contract import DaemonAddress

PROBE_TIMEOUT: Final = 10.0
"""Seconds for the owner's answer; ros2cli's daemon serves one client after the other."""
STOP_TIMEOUT: Final = 10.0
"""Seconds until the port must be free after our daemon was asked to end."""
TIME_WAIT: Final = 65.0
"""Seconds until the port must be free after ros2cli's daemon was asked to end: that one closes
connections first, which keeps its port for 60 s in TIME_WAIT."""
_POLL: Final = 0.1
_NOTICE_AFTER: Final = 1.0
_RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
COMPARED: Final = (
    DOMAIN_VARIABLE,
    "RMW_IMPLEMENTATION",
    _RANGE,
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_DISCOVERY_SERVER",
    "ROS_SUPER_CLIENT",
    "ROS_SECURITY_ENABLE",
    "ROS_SECURITY_ENCLAVE_OVERRIDE",
    *PROFILE_VARIABLES,
    "CYCLONEDDS_URI",
    "ZENOH_ROUTER_CONFIG_URI",
    "ZENOH_SESSION_CONFIG_URI",
    "ZENOH_CONFIG_OVERRIDE",
)
"""The environment variables that two processes must share in order to discover the same nodes; a
process reads them once, when its participant is created."""
_DEFAULTS: Final = {
    DOMAIN_VARIABLE: "0",
    _RANGE: "SUBNET",
    "ROS_LOCALHOST_ONLY": "0",
    "ROS_SECURITY_ENABLE": "false",
}


class OwnerKind(Enum):
    """The kind of process that owns the port."""

    FREE = auto()
    OURS = auto()
    STOCK = auto()
    """ros2cli's daemon."""
    OTHER = auto()
    """Anything else, or a daemon that does not answer."""


@dataclass(frozen=True, slots=True)
class PortOwner:
    """The process that listens on the port of a domain."""

    kind: OwnerKind
    pid: int = 0
    """0 where the process belongs to another user."""
    command: str = ""
    status: Mapping[str, Any] = field(default_factory=dict)
    """The status of our daemon. Where its process is of the same user,
    ``settings`` are those of its environment that discovery depends on."""
    problem: str = ""
    """The reason why it is neither of the two daemons."""

    def __str__(self) -> str:
        if not self.pid:
            return "a process of another user"
        return f"process {self.pid} ({self.command[:120] or 'unknown command'})"


class PortHeldError(UserError):
    """The port belongs to a process that is no daemon, or does not become free."""

    exit_code = 1


@dataclass(frozen=True, slots=True)
class Port:
    """The acquired port: its socket, or the pid of our daemon that owns it."""

    listener: socket.socket | None
    pid: int
    messages: tuple[str, ...]


def find_owner(address: DaemonAddress, timeout: float = PROBE_TIMEOUT) -> PortOwner:
    """Return the owner of the port, which has ``timeout`` seconds for an answer."""
    client = GraphClient(address, timeout)
    try:
        try:
            status = json.loads(client.call(STATUS_METHOD))
        except RemoteError:
            if client.call("get_name").startswith(NODE_PREFIX):
                return PortOwner(OwnerKind.STOCK, *_listener(address.port))
            raise
        pid = int(status["pid"])
    except NoDaemonError:
        return PortOwner(OwnerKind.FREE)
    except (ValueError, KeyError, TypeError):
        problem = "its status is not that of a graph daemon"
        return PortOwner(OwnerKind.OTHER, *_listener(address.port), problem=problem)
    except DaemonError as error:
        return PortOwner(OwnerKind.OTHER, *_listener(address.port), problem=str(error))
    # They may hold passwords: the kernel gives them to the same user only.
    with contextlib.suppress(psutil.Error, OSError):
        environment = {**psutil.Process(pid).environ(), DOMAIN_VARIABLE: str(address.domain)}
        status["settings"] = compared_settings(environment, str(status.get("rmw", "")))
    return PortOwner(OwnerKind.OURS, pid, status=status)


def settings_warnings(owner: PortOwner, caller: Mapping[str, str]) -> tuple[str, ...]:
    """Describe the settings of our daemon that differ from those of the caller's environment."""
    if owner.kind is not OwnerKind.OURS:
        return ()
    settings = owner.status.get("settings")
    if not isinstance(settings, dict):
        return ("settings cannot be compared: the daemon's process is another user's, or hidden",)
    return tuple(differences(settings, compared_settings(caller)))


def compared_settings(environment: Mapping[str, str], rmw: str = "") -> dict[str, str]:
    """Return the settings that count and are set; ``rmw`` is the middleware really in use."""
    settings = {name: environment[name] for name in COMPARED if environment.get(name)}
    if rmw:
        settings["RMW_IMPLEMENTATION"] = rmw
    return settings


def differences(daemon: Mapping[str, str], caller: Mapping[str, str]) -> list[str]:
    """Describe each setting that differs; a caller that names no middleware accepts any."""
    found = []
    for name in COMPARED:
        default = _DEFAULTS.get(name, "")
        theirs, ours = daemon.get(name) or default, caller.get(name) or default
        if name == "RMW_IMPLEMENTATION" and not ours:
            continue
        if theirs != ours:
            found.append(
                f"{name}: the daemon has {theirs or 'not set'}, here it is {ours or 'not set'}"
            )
    return found


def acquire(
    address: DaemonAddress,
    *,
    restart: bool = False,
    environment: Mapping[str, str] = os.environ,
    notify: Callable[[str], None] = lambda _: None,
) -> Port:
    """Acquire the port, from another daemon if need be.

    A daemon of ours that runs is kept, and its settings compared with the environment, unless
    ``restart``. ``notify`` is called with a line when the port is not free for longer.

    Raises ``PortHeldError`` where it belongs to another process, and ``DaemonError``.
    """
    messages: tuple[str, ...] = ()
    owner = find_owner(address)
    if owner.kind is OwnerKind.OURS and not restart:
        return Port(None, owner.pid, settings_warnings(owner, environment))
    if owner.kind is OwnerKind.STOCK:
        messages = (f"took over from ros2cli's daemon{f' (pid {owner.pid})' * bool(owner.pid)}",)
    _request_end(address, owner)
    limit = TIME_WAIT if owner.kind is not OwnerKind.OURS else STOP_TIMEOUT
    begin = time.monotonic()
    is_notified = False
    while True:
        with contextlib.suppress(PortHeldError):
            return Port(listen(address), 0, messages)
        waited = time.monotonic() - begin
        if waited > limit:
            raise PortHeldError(f"port {address.port} did not become free within {limit:g} s")
        if waited > _NOTICE_AFTER:
            # Another start was faster, or a command of ros2cli has started its daemon again.
            owner = find_owner(address)
            if owner.kind is OwnerKind.OURS and not restart:
                return Port(None, owner.pid, settings_warnings(owner, environment))
            if owner.kind is not OwnerKind.FREE:
                _request_end(address, owner)
            elif not is_notified:
                is_notified = True
                notify(
                    f"port {address.port}: closed connections keep it for up to a minute "
                    "(TIME_WAIT); waiting"
                )
        time.sleep(_POLL)


def listen(address: DaemonAddress) -> socket.socket:
    """Return a socket that listens at ``address``; ``PortHeldError`` when the port is in use."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.bind((address.host, address.port))
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise PortHeldError(f"{address.host}:{address.port} is in use") from None
        raise DaemonError(f"{address.host}:{address.port}: {error.strerror or error}") from None
    return listener


def stop_daemon(address: DaemonAddress) -> PortOwner:
    """End the daemon of a domain, ours or ros2cli's, and return it as it was.

    Raises ``PortHeldError`` when the owner is no daemon, or does not end.
    """
    owner = find_owner(address)
    if owner.kind is OwnerKind.FREE:
        return owner
    _request_end(address, owner)
    deadline = time.monotonic() + STOP_TIMEOUT
    process = _process(owner.pid)
    while find_owner(address).kind is not OwnerKind.FREE or _lives(process):
        if time.monotonic() > deadline:
            raise PortHeldError(f"{owner} did not end within {STOP_TIMEOUT:g} s")
        time.sleep(_POLL)
    return owner


def _lives(process: psutil.Process | None) -> bool:
    try:
        if process is None or not process.is_running():
            return False
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def _request_end(address: DaemonAddress, owner: PortOwner) -> None:
    if owner.kind is OwnerKind.OTHER:
        raise PortHeldError(f"{owner} has the daemon's port {address.port}: {owner.problem}")
    if owner.kind is not OwnerKind.FREE:
        # It may end before it has answered.
        with contextlib.suppress(DaemonError):
            GraphClient(address, STOP_TIMEOUT).call(SHUTDOWN_METHOD)


def _listener(port: int) -> tuple[int, str]:
    """Return pid and command of the process that listens on ``port``; 0 where that is hidden."""
    with contextlib.suppress(psutil.Error, OSError, RuntimeError):
        for entry in psutil.net_connections("tcp"):
            is_it = entry.status == psutil.CONN_LISTEN and entry.laddr[1:2] == (port,)
            if is_it and entry.pid:
                return entry.pid, " ".join(psutil.Process(entry.pid).cmdline())
    return 0, ""


def _process(pid: int) -> psutil.Process | None:
    with contextlib.suppress(psutil.Error):
        return psutil.Process(pid) if pid else None
    return None
