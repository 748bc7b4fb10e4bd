"""``ros2cli.xmlrpc.local_server``: a server that one slow client cannot stop.

Upstream takes one connection after the other and reads each to its end, so that a client which
connects and sends nothing stops all others, and its queue holds five. Here each connection has a
thread, the functions are called one at a time, and the answers about the graph are given again for
a fifth of a second. The client closes first: otherwise the port would be taken for a minute
(TIME_WAIT), or a large answer cut off by the reset that upstream ends with.
"""

from __future__ import annotations

import contextlib
import functools
import re
import select
import socket
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

BACKLOG = 512
"""Connections that the kernel keeps for us; the kernel's own limit is 4096 by default."""
HEARTBEAT = 0.2
"""Seconds after which the loop comes round with nothing to do, and sees signals."""
CACHE_TIME = 0.2
"""Seconds for which an answer about the graph is given again."""
ADDRESS_TIME = 30.0
"""Seconds for which the machine's own addresses are remembered."""
REQUEST_TIME = 10.0
"""Seconds that a client may send nothing of its request, or take nothing of its answer."""
CLOSING_TIME = 1.0
"""Seconds that a client has to close after its answer."""
MOST_CONNECTIONS = 256
MOST_ANSWERS = 128
LARGEST_BODY = 1024 * 1024

_STATE = "_play_launch_state"
_OUR_HOST = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
_CHUNK = 64 * 1024


def apply(module: ModuleType) -> None:
    """Change the class of servers, and the function that lists the machine's addresses."""
    server = module.LocalXMLRPCServer
    addresses = Addresses(module.get_local_ipaddrs)
    verify, close, dispatch = (
        server.verify_request,
        server.server_close,
        server._marshaled_dispatch,  # noqa: SLF001 - documented as the method to override
    )

    @functools.wraps(verify)
    def verify_request(self: Any, request: Any, client_address: Any) -> bool:
        if verify(self, request, client_address):
            return True
        # Perhaps the address is new.
        addresses.forget()
        return bool(verify(self, request, client_address))

    @functools.wraps(close)
    def server_close(self: Any) -> None:
        state = self.__dict__.pop(_STATE, None)
        close(self)
        end = time.monotonic() + CLOSING_TIME
        for thread in tuple(state.answering) if state else ():
            thread.join(max(0.0, end - time.monotonic()))

    @functools.wraps(dispatch)
    def marshaled_dispatch(self: Any, data: bytes, *arguments: Any) -> bytes:
        return state_of(self).answer(data, lambda: dispatch(self, data, *arguments))

    module.get_local_ipaddrs = addresses.current  # type: ignore[attr-defined]
    server.verify_request = verify_request
    server.server_close = server_close
    server._marshaled_dispatch = marshaled_dispatch  # noqa: SLF001 - as above
    server.handle_request = handle_request
    server.process_request = process_request
    server.request_queue_size = BACKLOG


def handle_request(self: Any) -> None:
    """Accept a client, if one comes within a heartbeat.

    Calls the server's ``handle_timeout`` as upstream's method does: when no request was answered
    for ``timeout`` seconds. Also when rclpy was shut down by a signal, which the daemon of Humble
    does not look for itself.
    """
    state = state_of(self)
    limit = self.timeout
    wait = HEARTBEAT if limit is None else min(HEARTBEAT, limit)
    if select.select([self.socket], [], [], wait)[0]:
        self._handle_request_noblock()
    idle = time.monotonic() - state.last_answer
    if (limit is not None and idle >= limit) or _rclpy_has_ended():
        self.handle_timeout()


def process_request(self: Any, request: socket.socket, client_address: Any) -> None:
    """Serve a client in a thread; where there are too many, the oldest one is disconnected."""
    state = state_of(self)
    if len(state.clients) >= MOST_CONNECTIONS:
        oldest = next(iter(tuple(state.clients)))  # threads remove their own meanwhile
        state.clients.pop(oldest, None)
        with contextlib.suppress(OSError):
            oldest.shutdown(socket.SHUT_RDWR)
    state.clients[request] = None
    threading.Thread(
        target=_serve, args=(self, state, request, client_address), daemon=True
    ).start()


def state_of(server: Any) -> State:
    """Return the state of a server, which it gets in the process that serves."""
    state: State | None = server.__dict__.get(_STATE)
    if state is None:
        state = server.__dict__[_STATE] = State()
        # The process that made the server may not have had this overlay.
        server.socket.listen(BACKLOG)
        server.socket.setblocking(False)
    return state


class State:
    """Clients and answers of one server."""

    def __init__(self) -> None:
        self.last_answer = time.monotonic()
        self.clients: dict[socket.socket, None] = {}
        """The oldest is the first."""
        self.answering: set[threading.Thread] = set()
        self._calling = threading.Lock()
        self._answers: dict[bytes, tuple[float, bytes]] = {}

    def answer(self, request: bytes, call: Callable[[], bytes]) -> bytes:
        """Return the answer to a call, which may be a fifth of a second old."""
        with self._calling:
            self.last_answer = time.monotonic()
            known = self._answers.get(request)
            if known is not None and self.last_answer < known[0]:
                return known[1]
            answer = call()
            # From the end of the call: it may have taken long.
            self.last_answer = time.monotonic()
            about_graph = b"<methodName>get_" in request or b"<methodName>count_" in request
            # A fault is near the beginning.
            if about_graph and b"<fault>" not in answer[:1024]:
                if len(self._answers) >= MOST_ANSWERS:
                    self._answers.clear()
                self._answers[request] = (self.last_answer + CACHE_TIME, answer)
            return answer


def _serve(server: Any, state: State, request: socket.socket, client_address: Any) -> None:
    try:
        _guarded(server.RequestHandlerClass)(request, client_address, server)
        end = time.monotonic() + CLOSING_TIME
        request.settimeout(CLOSING_TIME)
        while request.recv(_CHUNK) and time.monotonic() < end:
            pass
    except OSError:
        pass
    except Exception:  # noqa: BLE001 - as upstream's server does
        server.handle_error(request, client_address)
    finally:
        state.clients.pop(request, None)
        server.close_request(request)
        state.answering.discard(threading.current_thread())


@functools.lru_cache
def _guarded(handler: Any) -> Any:
    """Return a handler that refuses pages of the web and large requests, and does not wait long."""

    class Guarded(handler):  # type: ignore[misc]
        timeout = REQUEST_TIME

        def do_POST(self) -> None:  # noqa: N802 - the standard library's name
            state_of(self.server).answering.add(threading.current_thread())
            length = self.headers.get("Content-Length", "")
            hosts = self.headers.get_all("Host", ())
            # Only browsers send an origin; a name made to point to this machine is not ours.
            if "Origin" in self.headers or not all(map(_OUR_HOST.fullmatch, hosts)):
                self.send_error(403)
            elif length.isdecimal() and (len(length) > 9 or int(length) > LARGEST_BODY):
                self.send_error(413)
            else:
                super().do_POST()

    return Guarded


def _rclpy_has_ended() -> bool:
    rclpy = sys.modules.get("rclpy")
    return rclpy is not None and not rclpy.ok()


class Addresses:
    """The machine's own addresses, remembered for a while."""

    def __init__(self, look: Callable[[], list[str]]) -> None:
        self._look = look
        self._found: list[str] = []
        self._until = 0.0

    def current(self) -> list[str]:
        """Return the addresses, at most ``ADDRESS_TIME`` old."""
        now = time.monotonic()
        if now >= self._until:
            self._found = self._look()
            self._until = now + ADDRESS_TIME
        return list(self._found)

    def forget(self) -> None:
        """Look again next time."""
        self._until = 0.0
