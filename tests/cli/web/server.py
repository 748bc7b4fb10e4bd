"""A running `play-launch web`, and requests to it."""

from __future__ import annotations

import http.client
import re
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from tests.support.replay import COMMAND

SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}


@dataclass
class Server:
    """What it printed, and where it listens."""

    process: subprocess.Popen[str]
    invitations: list[str]
    open: list[http.client.HTTPConnection] = field(default_factory=list)

    @property
    def url(self) -> str:
        return self.invitations[0].partition("?")[0]

    @property
    def port(self) -> int:
        found = re.search(r":(\d+)/", self.invitations[0])
        assert found is not None
        return int(found[1])

    @property
    def tokens(self) -> list[str]:
        return [each.partition("?token=")[2] for each in self.invitations]

    def get(self, path: str = "/", **headers: str) -> tuple[int, Mapping[str, str], str]:
        """Request a path; the status, the headers and the text of the answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        try:
            connection.request("GET", path, headers={"Host": f"127.0.0.1:{self.port}", **headers})
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read().decode()
        finally:
            connection.close()

    def status(self, path: str = "/", **headers: str) -> int:
        return self.get(path, **headers)[0]

    def socket(self, path: str = SOCKET, **headers: str) -> int:
        """Open a WebSocket that stays open, and that is never read; the status."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        self.open.append(connection)
        connection.request("GET", path, headers={**UPGRADE, **headers})
        return connection.getresponse().status


@contextmanager
def serving(*arguments: object, count: int = 1) -> Iterator[Server]:
    """Run it until the end of the block; ``count`` is how many addresses it prints."""
    command = [str(COMMAND), "web", "--port", "0", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        server = Server(process, [process.stdout.readline().split(" ")[0] for _ in range(count)])
        try:
            yield server
        finally:
            for each in server.open:
                each.close()
            process.terminate()
            process.wait(20)
