# mypy: ignore-errors
# Its imports are found where a test has installed it, and nowhere else.
"""A daemon whose answers are about itself."""

import os
import sys
from typing import Any
from xmlrpc.server import SimpleXMLRPCRequestHandler

import rclpy
import ros2cli.xmlrpc.local_server as local
from ros2cli.helpers import before_invocation, pretty_print_call
from ros2cli.node.network_aware import NetworkAwareNode
from ros2cli.xmlrpc.local_server import LocalXMLRPCServer


class RequestHandler(SimpleXMLRPCRequestHandler):
    """Only one path."""

    rpc_paths = ("/ros2cli/",)


def make_xmlrpc_server() -> LocalXMLRPCServer:
    """Listen on a port of the kernel's choice."""
    return LocalXMLRPCServer(
        ("127.0.0.1", 0), requestHandler=RequestHandler, logRequests=False, allow_none=True
    )


def serve(server: LocalXMLRPCServer, *, like_humble: bool, timeout: float) -> None:
    """Answer until told to stop, or idle for ``timeout`` seconds."""
    node = NetworkAwareNode()
    counted = [0]
    ended = [False]

    def get_count() -> int:
        counted[0] += 1
        return counted[0]

    def get_listings(_call: int) -> int:
        return local.listings

    def get_large(size: int) -> str:
        return "x" * size

    def get_error() -> None:
        counted[0] += 1
        raise RuntimeError(f"failed {counted[0]} times")

    def get_looks(call: int) -> Any:
        return node.get_looks(call)

    def shutdown() -> None:
        ended[0] = True

    def timed_out() -> None:
        # Humble's stops when it is called; Jazzy's is called all the time and looks itself.
        if like_humble:
            ended[0] = True

    for function in (get_count, get_listings, get_large, get_error, get_looks):
        server.register_function(before_invocation(function, pretty_print_call))
    server.register_introspection_functions()
    server.register_function(shutdown, "system.shutdown")
    server.register_function(get_count, "system.count")
    server.handle_timeout = timed_out  # type: ignore[method-assign]
    server.timeout = timeout if like_humble else 0.2
    print("port", server.server_address[1], flush=True)
    while not ended[0] and (like_humble or rclpy.ok()):
        server.handle_request()


def main() -> None:
    """Run it; ``LIKE_HUMBLE`` and ``TIMEOUT`` come from the environment."""
    rclpy.init()
    with make_xmlrpc_server() as server:
        serve(
            server,
            like_humble=bool(os.environ.get("LIKE_HUMBLE")),
            timeout=float(os.environ.get("TIMEOUT", "7200")),
        )
    print("ended", flush=True)
    sys.exit(0)
