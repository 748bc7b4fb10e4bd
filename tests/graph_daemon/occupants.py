"""Programs that own the port: ``python -m tests.graph_daemon.occupants KIND PORT``.

They print "up" when they listen.
"""

from __future__ import annotations

import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import psutil

ROOT = Path(__file__).resolve().parents[2]


def end_daemons(domain: int) -> None:
    """Kill daemons of ours of a domain, which a test that failed may have left."""
    for process in psutil.process_iter(["cmdline"]):
        if {"play_launch.graph_daemon", f"--domain={domain}"} <= set(process.info["cmdline"] or ()):
            process.kill()


class Handler(SimpleXMLRPCRequestHandler):
    rpc_paths = ("/ros2cli/",)


class Stock(SimpleXMLRPCServer):
    """Like ros2cli's daemon, but leaves no connection in TIME_WAIT unless it is to."""

    allow_reuse_address = False
    ended = False
    leaves_time_wait = False

    def get_request(self) -> tuple[socket.socket, Any]:
        client, address = super().get_request()
        if not self.leaves_time_wait:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        return client, address

    def shutdown_request(self, request: Any) -> None:
        if not self.leaves_time_wait:
            while request.recv(1000):
                pass
        super().shutdown_request(request)

    def end(self) -> None:
        self.ended = True


def serve(server: Stock) -> None:
    server.timeout = 0.2
    while not server.ended:
        server.handle_request()
    server.server_close()


def stock(port: int, *, leaves_time_wait: bool = False) -> None:
    server = Stock(("127.0.0.1", port), Handler, logRequests=False, allow_none=True)
    server.register_introspection_functions()
    server.leaves_time_wait = leaves_time_wait
    server.register_function(lambda: "_ros2cli_daemon_0_stand-in", "get_name")
    server.register_function(server.end, "system.shutdown")
    print("up", flush=True)
    serve(server)


def other(port: int) -> None:
    server = Stock(("127.0.0.1", port), Handler, logRequests=False)
    server.register_introspection_functions()
    print("up", flush=True)
    serve(server)


def impostor(port: int) -> None:
    """Have the methods of our daemon, and a status of another form."""
    server = Stock(("127.0.0.1", port), Handler, logRequests=False)
    server.register_introspection_functions()
    server.register_function(lambda: "_ros2cli_daemon_0_stand-in", "get_name")
    server.register_function(lambda: 0, "system.shutdown")
    server.register_function(lambda: '{"pid": "a robot"}', "system.play_launch_status")
    print("up", flush=True)
    serve(server)


def silent(port: int) -> None:
    with socket.create_server(("127.0.0.1", port)):
        print("up", flush=True)
        sys.stdin.read()


def main() -> None:
    kind, port = sys.argv[1], int(sys.argv[2])
    if kind == "stock":
        stock(port)
    elif kind == "time_wait":
        stock(port, leaves_time_wait=True)
    elif kind == "other":
        other(port)
    elif kind == "impostor":
        impostor(port)
    else:
        silent(port)


@contextmanager
def occupied(kind: str, port: int, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run one of them; ``words`` are added to its command line."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.graph_daemon.occupants", kind, str(port), *words],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"up\n"
            yield process
        finally:
            process.kill()


if __name__ == "__main__":
    main()
