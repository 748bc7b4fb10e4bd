"""Speaks the control channel with the real container, byte by byte.

The supervisor's own client is left out on purpose: both ends are tested against the protocol, not
against each other.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from play_launch_msgs.msg import (
    ComponentEvent,
    ControlAccepted,
    ControlCancel,
    ControlHello,
    ControlLoad,
    ControlQuery,
    ControlRejected,
    ControlShutdown,
    ControlStatus,
    ControlUnload,
)
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rclpy.serialization import deserialize_message, serialize_message

HELLO, LOAD, ACCEPTED, REJECTED, EVENT = 1, 2, 3, 4, 5
QUERY, STATUS, CANCEL, UNLOAD, SHUTDOWN = 6, 7, 8, 9, 10
INCOMING = {
    HELLO: ControlHello,
    ACCEPTED: ControlAccepted,
    REJECTED: ControlRejected,
    EVENT: ComponentEvent,
    STATUS: ControlStatus,
}
OUTGOING = {
    ControlHello: HELLO,
    ControlLoad: LOAD,
    ControlQuery: QUERY,
    ControlCancel: CANCEL,
    ControlUnload: UNLOAD,
    ControlShutdown: SHUTDOWN,
}
TIMEOUT = 60.0
"""Seconds after which something that should have come is missed."""
PAUSE = 0.01
"""Seconds between two looks at what has no event; without it, looking takes a processor."""


def frame(kind: int, payload: bytes, version: int = 1) -> bytes:
    return struct.pack("<IHH", 4 + len(payload), kind, version) + payload


def parameter(name: str, value: bool | float | str) -> Parameter:
    fields: dict[type, tuple[int, str]] = {
        bool: (ParameterType.PARAMETER_BOOL, "bool_value"),
        int: (ParameterType.PARAMETER_INTEGER, "integer_value"),
        float: (ParameterType.PARAMETER_DOUBLE, "double_value"),
        str: (ParameterType.PARAMETER_STRING, "string_value"),
    }
    kind, field = fields[type(value)]
    return Parameter(name=name, value=ParameterValue(type=kind, **{field: value}))


class Container:
    """A container and the supervisor's end of its control channel."""

    def __init__(self, process: subprocess.Popen[bytes], peer: socket.socket | None, log: Path):
        self.process = process
        self.peer = peer
        self.log = log
        self.control_socket = ""  # the container's end, as /proc names it
        self.seen: list[Any] = []
        self._attempt = 0
        self._buffer = b""
        self._pidfd = os.pidfd_open(process.pid)

    def send(self, message: Any) -> None:
        self.send_bytes(frame(OUTGOING[type(message)], serialize_message(message)))

    def send_bytes(self, data: bytes) -> None:
        assert self.peer is not None
        self.peer.sendall(data)

    def load(self, plugin: str, *, package: str = "play_launch_demo", **fields: Any) -> int:
        """Ask for a component; returns the attempt."""
        self._attempt += 1
        parameters = [parameter(n, v) for n, v in fields.pop("parameters", {}).items()]
        extra = [parameter(n, v) for n, v in fields.pop("extra_arguments", {}).items()]
        self.send(
            ControlLoad(
                attempt=fields.pop("attempt", self._attempt),
                package_name=package,
                plugin_name=plugin if "::" in plugin else f"{package}::{plugin}",
                parameters=parameters,
                extra_arguments=extra,
                **fields,
            )
        )
        return self._attempt

    def receive(self, what: str = "a frame") -> Any:
        """The next message, in the order in which they were sent."""
        assert self.peer is not None
        deadline = time.monotonic() + TIMEOUT
        while True:
            if len(self._buffer) >= 4:
                (length,) = struct.unpack_from("<I", self._buffer)
                if len(self._buffer) >= 4 + length:
                    kind, version = struct.unpack_from("<HH", self._buffer, 4)
                    payload, self._buffer = (
                        self._buffer[8 : 4 + length],
                        self._buffer[4 + length :],
                    )
                    assert version == 1
                    message = deserialize_message(payload, INCOMING[kind])
                    self.seen.append(message)
                    return message
            self.peer.settimeout(max(0.001, deadline - time.monotonic()))
            try:
                data = self.peer.recv(65536)
            except TimeoutError:
                pytest.fail(f"waited {TIMEOUT} s for {what}; log:\n{self.log.read_text()}")
            if not data:
                raise EOFError(f"the container closed the channel; log:\n{self.log.read_text()}")
            self._buffer += data

    def until(self, match: Callable[[Any], bool], what: str) -> Any:
        """Receive until a message matches; that message."""
        while True:
            message = self.receive(what)
            if match(message):
                return message

    def event(self, kind: int, **fields: Any) -> ComponentEvent:
        """Receive until an event of that kind with those fields."""
        return self.until(
            lambda m: (
                isinstance(m, ComponentEvent)
                and m.event_type == kind
                and all(getattr(m, name) == value for name, value in fields.items())
            ),
            f"event {kind} {fields}",
        )

    def loaded(self, plugin: str, **fields: Any) -> ComponentEvent:
        """Load a component and wait for it."""
        attempt = self.load(plugin, **fields)
        event = self.until(
            lambda m: (
                isinstance(m, ComponentEvent)
                and m.attempt == attempt
                and m.event_type != ComponentEvent.LOADING
            ),
            f"the end of attempt {attempt}",
        )
        assert event.event_type == ComponentEvent.LOADED, event
        return event

    def status(self, *unique_ids: int) -> ControlStatus:
        query_id = time.monotonic_ns()  # unlike any other
        self.send(ControlQuery(query_id=query_id, unique_ids=list(unique_ids)))
        return self.until(
            lambda m: isinstance(m, ControlStatus) and m.query_id == query_id, "the status"
        )

    def status_when(self, done: Callable[[ControlStatus], bool], what: str) -> ControlStatus:
        """Ask for the status again and again, as a supervisor does, until it is ``done``."""
        deadline = time.monotonic() + TIMEOUT
        while not done(status := self.status()):
            assert time.monotonic() < deadline, f"waited {TIMEOUT} s for {what}: {status}"
            time.sleep(PAUSE)
        return status

    def wait(self, timeout: float = TIMEOUT) -> int:
        """Wait until the process is gone; its exit status, or minus the signal."""
        ready, _, _ = select.select([self._pidfd], [], [], timeout)
        assert ready, f"still there after {timeout} s; log:\n{self.log.read_text()}"
        return self.process.wait()

    def shut_down(self) -> int:
        self.send(ControlShutdown(reason="test"))
        return self.wait()

    def threads(self) -> int:
        return len(list(Path(f"/proc/{self.process.pid}/task").iterdir()))

    def descriptors(self) -> int:
        return len(list(Path(f"/proc/{self.process.pid}/fd").iterdir()))

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self._pidfd)
        if self.peer is not None:
            self.peer.close()


StartContainer = Callable[..., Container]
"""The fixture `spawn`: arguments of the container, and as keywords `name`, `control` (False: no
channel), `greet` (False: the hello is left to the test), `failpoints`, `environment`."""
