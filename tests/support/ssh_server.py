"""A small ssh server for hosts on which no sshd is installed: commands, SFTP, UNIX sockets.

Called as ``python -m tests.support.ssh_server HOST_KEY AUTHORIZED_KEYS HOME``.
"""

from __future__ import annotations

import asyncio
import os
import sys
from typing import Any

import asyncssh


class _Server(asyncssh.SSHServer):
    authorized = ""

    def connection_made(self, conn: asyncssh.SSHServerConnection) -> None:
        self._connection = conn

    def begin_auth(self, username: str) -> bool:
        if username == "root":
            self._connection.set_authorized_keys(self.authorized)
        return True

    def unix_connection_requested(self, dest_path: str) -> bool:
        del dest_path
        return True


async def _main(host_key: str, authorized: str, home: str) -> None:
    _Server.authorized = authorized

    async def carry_out(process: Any) -> None:
        peer = process.get_extra_info("peername")[0]
        child = await asyncio.create_subprocess_shell(
            os.fsdecode(process.command or b"true"),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env={**os.environ, "HOME": home, "SSH_CONNECTION": f"{peer} 0 0 22"},
        )
        stdout, stderr = await child.communicate()
        process.stdout.write(stdout)
        process.stderr.write(stderr)
        process.exit(child.returncode or 0)

    await asyncssh.listen(
        "",
        22,
        server_factory=_Server,
        server_host_keys=[host_key],
        process_factory=carry_out,
        sftp_factory=True,
        encoding=None,
    )
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(_main(*sys.argv[1:]))
