"""Makes hosts out of this machine, for the demo: network namespaces, each with an ssh server.

They are on one bridge, which nothing else is connected to; each has a /dev/shm and a /run of its
own. The rest of the file system and the pids are shared. Needs root, iproute2, util-linux,
OpenSSH's ssh-keygen and asyncssh. As a program it is the ssh server of one host.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Self

_PROGRAMS: Final = {
    "ip": "iproute2",
    "nsenter": "util-linux",
    "setpriv": "util-linux",
    "ssh-keygen": "openssh-client",
    "unshare": "util-linux",
}
_LONGEST_KILL: Final = 10.0
_NAME: Final = re.compile(r"pl(\d+)(?:h\d+|sw)")


def missing() -> str:
    """Say what the hosts need and is not here; empty if they can be made."""
    if find_spec("asyncssh") is None:
        return "needs asyncssh: pip install 'play-launch-py[machines]'"
    if os.geteuid() != 0:
        return "needs root, for network namespaces"
    absent = sorted({package for each, package in _PROGRAMS.items() if shutil.which(each) is None})
    if absent:
        return f"needs the packages {', '.join(absent)}"
    try:
        _run("unshare", "-n", "true")
    except OSError as error:
        return f"network namespaces cannot be made here ({error})"
    return ""


class Namespaces:
    """Hosts h1, h2, ... with the addresses 10.77.0.1, ...; as a context they exist within it.

    Programs on h1 reach the others by these names, with a key that is made for them: `environment`
    has its home. Raises OSError where a program fails.
    """

    def __init__(self, folder: Path, count: int) -> None:
        self.folder = folder
        self.count = count
        self.home = folder / "home1"
        self._id = f"pl{os.getpid()}"
        self._switch = f"{self._id}sw"
        self._numbers: list[int] = []
        self._servers: dict[int, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        try:
            self._make()
        except BaseException:
            self.remove()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()

    def namespace(self, number: int) -> str:
        return f"{self._id}h{number}"

    def command(self, *words: str, host: int = 1) -> list[str]:
        """Return a command that runs on a host, in its file systems."""
        pid = self._servers[host].pid
        network = f"--net=/run/netns/{self.namespace(host)}"
        return ["nsenter", network, f"--mount=/proc/{pid}/ns/mnt", *words]

    @property
    def environment(self) -> dict[str, str]:
        """Of a program on h1: this one's, without settings of play-launch, ssh and discovery."""
        kept = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("PLAY_LAUNCH_", "SSH_"))
            and name != "ROS_AUTOMATIC_DISCOVERY_RANGE"
        }
        return {**kept, "HOME": str(self.home)}

    def pids(self, number: int) -> list[int]:
        return _pids(self.namespace(number))

    def kill(self, number: int) -> None:
        """Kill all that runs on a host, its ssh server as well."""
        _kill_all(self.namespace(number))

    def remove(self) -> None:
        """Kill what runs on the hosts, and remove their networks."""
        for number in self._numbers:
            self.kill(number)
        for server in self._servers.values():
            # The shell before it is in no namespace.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(server.pid, signal.SIGKILL)
            server.wait()
            if server.stdout is not None:
                server.stdout.close()
        for name in (*map(self.namespace, self._numbers), self._switch):
            _delete(name)

    def _make(self) -> None:
        _remove_those_of_the_dead()
        ssh = self.home / ".ssh"
        ssh.mkdir(parents=True)
        _run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(ssh / "id_ed25519"))
        _run("ip", "netns", "add", self._switch)
        bridge = ("bridge0", "type", "bridge", "mcast_snooping", "0")
        _run("ip", "-n", self._switch, "link", "add", *bridge)
        _run("ip", "-n", self._switch, "link", "set", "bridge0", "up")
        known, aliases = [], []
        for number in range(1, self.count + 1):
            self.make_network(number)
            known.append(f"10.77.0.{number} {self._serve(number)}\n")
            aliases.append(f"Host h{number}\n  HostName 10.77.0.{number}\n  User root\n")
        (ssh / "known_hosts").write_text("".join(known))
        (ssh / "config").write_text("".join(aliases))

    def make_network(self, number: int) -> None:
        """Make the network namespace of a host, and connect it to the switch."""
        name, link = self.namespace(number), f"v{number}"
        self._numbers.append(number)
        _run("ip", "netns", "add", name)
        _run("ip", "-n", name, "link", "set", "lo", "up")
        _run(
            *("ip", "-n", self._switch, "link", "add", link, "type", "veth"),
            *("peer", "name", "eth0", "netns", name),
        )
        _run("ip", "-n", self._switch, "link", "set", link, "master", "bridge0", "up")
        _run("ip", "-n", name, "addr", "add", f"10.77.0.{number}/24", "dev", "eth0")
        _run("ip", "-n", name, "link", "set", "eth0", "up")
        _run("ip", "-n", name, "route", "add", "default", "dev", "eth0")

    def set_link(self, number: int, state: str) -> None:
        """Plug the cable of a host in (`up`) or out (`down`)."""
        _run("ip", "-n", self._switch, "link", "set", f"v{number}", state)

    def server_command(self, folder: Path, home: Path) -> list[str]:
        """Return what runs as the ssh server of a host; `folder` has its `hostkey`.

        It prints a line once it runs there.
        """
        authorized = self.home / ".ssh/id_ed25519.pub"
        module = ("-P", "-m", "play_launch.deploy.machines.namespaces")
        return [sys.executable, *module, str(folder / "hostkey"), str(authorized), str(home)]

    def _serve(self, number: int) -> str:
        """Start the ssh server of a host, and return its public key."""
        folder, home = self.folder / f"h{number}", self.folder / f"home{number}"
        folder.mkdir()
        home.mkdir(exist_ok=True)
        key = folder / "hostkey"
        _run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "", "-f", str(key))
        script = (
            "mount -t tmpfs tmpfs /dev/shm && mount -t tmpfs tmpfs /run && mkdir -p /run/sshd && "
            f"exec {shlex.join(self.server_command(folder, home))}"
        )
        network = f"--net=/run/netns/{self.namespace(number)}"
        words = (*ends_with_us("KILL"), "nsenter", network, "unshare", "-m", "bash", "-c", script)
        log = folder / "sshd.log"
        with log.open("wb") as opened:
            server = self._servers[number] = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=opened,
                start_new_session=True,
            )
        assert server.stdout is not None
        # A process that is still on its way would not be found, and outlive the host.
        if not server.stdout.readline():
            raise OSError(f"the ssh server of h{number}: {log.read_text().strip()}")
        return key.with_suffix(".pub").read_text().strip()


def ends_with_us(number: str) -> tuple[str, ...]:
    """Return the words before a command that gets this signal when this process is killed."""
    return ("setpriv", "--pdeathsig", number)


def _run(*words: str) -> str:
    done = subprocess.run(
        words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise OSError(f"{shlex.join(words)}: {done.stderr.strip()}")
    return done.stdout


def _pids(namespace: str) -> list[int]:
    try:
        return [int(each) for each in _run("ip", "netns", "pids", namespace).split()]
    except OSError:  # it is not there
        return []


def _kill_all(namespace: str) -> None:
    deadline = time.monotonic() + _LONGEST_KILL
    while (pids := _pids(namespace)) and time.monotonic() < deadline:
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.02)


def _delete(namespace: str) -> None:
    with contextlib.suppress(OSError):  # it is not there
        _run("ip", "netns", "del", namespace)


def _remove_those_of_the_dead() -> None:
    """Remove what earlier processes that were killed have left."""
    for line in _run("ip", "netns", "list").splitlines():
        found = _NAME.fullmatch(line.split()[0])
        if found is not None and not Path(f"/proc/{found[1]}").exists():
            _kill_all(found[0])
            _delete(found[0])


async def _serve_ssh(host_key: str, authorized: str, home: str) -> None:
    """Carry out commands, SFTP and connections to UNIX sockets for root with that key."""
    import asyncssh  # noqa: PLC0415 - the extra `machines`

    class Server(asyncssh.SSHServer):
        def connection_made(self, conn: asyncssh.SSHServerConnection) -> None:
            self._connection = conn

        def begin_auth(self, username: str) -> bool:
            if username == "root":
                self._connection.set_authorized_keys(authorized)
            return True

        def unix_connection_requested(self, dest_path: str) -> bool:
            del dest_path
            return True

    async def carry_out(process: Any) -> None:
        peer = process.get_extra_info("peername")[0]
        child = await asyncio.create_subprocess_shell(
            os.fsdecode(process.command or b"true"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env={**os.environ, "HOME": home, "SSH_CONNECTION": f"{peer} 0 0 22"},
        )
        await process.redirect(stdin=child.stdin)
        assert child.stdout is not None
        assert child.stderr is not None
        # Redirected, output that comes right before the end was lost now and then.
        stdout, stderr = await asyncio.gather(child.stdout.read(), child.stderr.read())
        process.stdout.write(stdout)
        process.stderr.write(stderr)
        process.exit(await child.wait())

    await asyncssh.listen(
        "",
        22,
        server_factory=Server,
        server_host_keys=[host_key],
        process_factory=carry_out,
        sftp_factory=True,
        encoding=None,
    )
    print("ready", flush=True)  # noqa: T201 - to the process that waits for it
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(_serve_ssh(*sys.argv[1:]))
