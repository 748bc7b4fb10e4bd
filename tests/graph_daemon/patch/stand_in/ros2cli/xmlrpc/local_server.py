"""A server for this machine only."""

import socket
import struct
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

listings = 0


def get_local_ipaddrs() -> list[str]:
    """List this machine's addresses, and count how often that is asked."""
    global listings  # noqa: PLW0603
    listings += 1
    return ["127.0.0.1"]


class LocalXMLRPCServer(SimpleXMLRPCServer):
    """Resets instead of closing, as the real one."""

    allow_reuse_address = False

    def get_request(self) -> tuple[socket.socket, Any]:
        connection, address = super().get_request()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        return connection, address

    def verify_request(self, request: Any, client_address: Any) -> bool:
        return client_address[0] in get_local_ipaddrs() and bool(
            super().verify_request(request, client_address)
        )
