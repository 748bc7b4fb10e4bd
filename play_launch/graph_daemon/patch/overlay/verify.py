"""Shows whether the overlay works with the ros2cli of this Python: one JSON object on stdout.

Imports the daemon's modules as ``ros2`` does, looks whether each was changed, and lets a server of
theirs answer a call on loopback while another client is connected and silent.
"""

from __future__ import annotations

import importlib
import json
import socket
import sys
import threading
import time
import xmlrpc.client
from typing import Any

CHANGES = importlib.import_module(__package__ or "").CHANGES
MARK = importlib.import_module(f"{__package__}.loading").MARK
_ANSWER = "overlay"
_LIMIT = 30.0


def problems() -> list[str]:
    """Return what is not as it should be; nothing if all is well."""
    found = []
    modules: dict[str, Any] = {}
    for name, change in CHANGES.items():
        try:
            modules[name] = importlib.import_module(name)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is reported
            return [f"{name} cannot be imported: {error!r}"]
        mark = getattr(modules[name], MARK, "not changed")
        if mark != change:
            found.append(f"{name}: {mark}")
    return found or _call_problems(modules)


def _call_problems(modules: dict[str, Any]) -> list[str]:
    server = modules["ros2cli.xmlrpc.local_server"].LocalXMLRPCServer(
        ("127.0.0.1", 0),
        logRequests=False,
        requestHandler=modules["ros2cli.daemon"].RequestHandler,
        allow_none=True,
    )
    answers: list[Any] = []
    with server, socket.create_connection(server.server_address, timeout=_LIMIT):
        server.register_function(lambda: _ANSWER, "get_name")
        url = "http://{}:{}/ros2cli/".format(*server.server_address)
        client = threading.Thread(target=_ask, args=(url, answers), daemon=True)
        client.start()
        deadline = time.monotonic() + _LIMIT
        while client.is_alive() and time.monotonic() < deadline:
            server.handle_request()
    return [] if answers == [_ANSWER] else [f"a call was answered with {answers!r}"]


def _ask(url: str, answers: list[Any]) -> None:
    try:
        with xmlrpc.client.ServerProxy(url) as proxy:
            answers.append(proxy.get_name())
    except Exception as error:  # noqa: BLE001 - reported as the answer
        answers.append(repr(error))


def main() -> int:
    """Print the outcome; 0 when the overlay works."""
    found = problems()
    sys.stdout.write("\n" + json.dumps({"problems": found}) + "\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
