"""Programs that have the port: ``python -m tests.graph_daemon.control.occupants KIND PORT``.

They say "up" when they have it.
"""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

from play_launch.graph_daemon.contract import BASE_PORT, DaemonAddress
from play_launch.graph_daemon.control.port import listen_within

ROOT = Path(__file__).resolve().parents[3]


class Handler(SimpleXMLRPCRequestHandler):
    rpc_paths = ("/ros2cli/",)


class Stock(SimpleXMLRPCServer):
    """Like ros2cli's daemon: closes first, and does not share its port."""

    allow_reuse_address = False
    ended = False

    def end(self) -> None:
        self.ended = True


def serve(server: Stock) -> None:
    server.timeout = 0.2
    while not server.ended:
        server.handle_request()
    server.server_close()


def stock(port: int, *, stubborn: bool = False) -> None:
    server = Stock(("127.0.0.1", port), Handler, logRequests=False, allow_none=True)
    server.register_introspection_functions()
    server.register_function(lambda: "stand-in", "get_name")
    server.register_function((lambda: None) if stubborn else server.end, "system.shutdown")
    print("up", flush=True)
    serve(server)


def other(port: int) -> None:
    server = Stock(("127.0.0.1", port), Handler, logRequests=False)
    server.register_introspection_functions()
    print("up", flush=True)
    serve(server)


def impostor(port: int) -> None:
    """Have the methods of our daemon, and a status that is none of its own."""
    server = Stock(("127.0.0.1", port), Handler, logRequests=False)
    server.register_introspection_functions()
    server.register_function(lambda: "stand-in", "get_name")
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
    elif kind == "stubborn":
        stock(port, stubborn=True)
    elif kind == "other":
        other(port)
    elif kind == "impostor":
        impostor(port)
    else:
        silent(port)


@contextmanager
def occupied(kind: str, port: int, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run one of them; ``words`` are added to its command line."""
    # The one before may have left connections in TIME_WAIT.
    listen_within(DaemonAddress(port - BASE_PORT), 60.0).close()
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.graph_daemon.control.occupants", kind, str(port), *words],
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
