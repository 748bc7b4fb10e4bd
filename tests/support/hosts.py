"""Hosts on this machine: network namespaces on a bridge, each with an ssh server and a /dev/shm.

They share the file system and the pids. Nothing leaves the namespaces.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

_PROGRAMS = ("ip", "unshare", "nsenter", "ssh-keygen")
_SSHD = "/usr/sbin/sshd"


def missing() -> str:
    """Say what hosts need and is not here; empty if they can be made."""
    if os.geteuid() != 0:
        return "needs root, for network namespaces"
    absent = [each for each in _PROGRAMS if shutil.which(each) is None]
    if absent:
        return f"needs {', '.join(absent)} (packages openssh-client, iproute2)"
    done = subprocess.run(["unshare", "-n", "true"], capture_output=True, check=False)
    return "" if done.returncode == 0 else "network namespaces cannot be made here"


class Hosts:
    """Hosts h1, h2, ...; commands run on h1, as if a person sat there."""

    def __init__(self, folder: Path, count: int) -> None:
        self.folder = folder
        self.count = count
        self._id = f"pl{os.getpid()}"
        self._sshds: dict[int, subprocess.Popen[bytes]] = {}
        self.home = folder / "home1"

    def namespace(self, number: int) -> str:
        return f"{self._id}h{number}"

    @property
    def _switch(self) -> str:
        return f"{self._id}sw"

    def up(self) -> None:
        (self.home / ".ssh").mkdir(parents=True)
        _run(
            "ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(self.home / ".ssh/id_ed25519")
        )
        _run("ip", "netns", "add", self._switch)
        _run(
            "ip",
            "-n",
            self._switch,
            "link",
            "add",
            "bridge0",
            "type",
            "bridge",
            "mcast_snooping",
            "0",
        )
        _run("ip", "-n", self._switch, "link", "set", "bridge0", "up")
        known, config = [], []
        for number in range(1, self.count + 1):
            name, link = self.namespace(number), f"v{number}"
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
            known.append(f"10.77.0.{number} {self._sshd(number)}")
            config.append(f"Host h{number}\n  HostName 10.77.0.{number}\n  User root\n")
        (self.home / ".ssh/known_hosts").write_text("\n".join(known) + "\n")
        (self.home / ".ssh/config").write_text("".join(config))

    def _sshd(self, number: int) -> str:
        """Start the ssh server of a host, and return its public key."""
        folder = self.folder / f"h{number}"
        folder.mkdir()
        key = folder / "hostkey"
        _run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "", "-f", str(key))
        home = self.folder / f"home{number}"
        home.mkdir(exist_ok=True)
        (folder / "sshd_config").write_text(
            f"Port 22\nHostKey {key}\nPidFile none\n"
            f"AuthorizedKeysFile {self.home}/.ssh/id_ed25519.pub\n"
            "PasswordAuthentication no\nUsePAM no\nStrictModes no\nPermitRootLogin yes\n"
            f"Subsystem sftp internal-sftp\nSetEnv HOME={home}\n"
        )
        server = f"{_SSHD} -D -e -f {folder}/sshd_config"
        if not Path(_SSHD).exists():
            authorized = f"{self.home}/.ssh/id_ed25519.pub"
            server = f"{sys.executable} -m tests.support.ssh_server {key} {authorized} {home}"
        script = (
            "mount -t tmpfs tmpfs /dev/shm; mount -t tmpfs tmpfs /run; mkdir -p /run/sshd; "
            f"exec {server}"
        )
        with (folder / "sshd.log").open("wb") as log:
            self._sshds[number] = subprocess.Popen(
                [
                    "nsenter",
                    f"--net=/run/netns/{self.namespace(number)}",
                    "unshare",
                    "-m",
                    "bash",
                    "-c",
                    script,
                ],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        return key.with_suffix(".pub").read_text().strip()

    def cut(self, number: int) -> None:
        """Take the cable of a host away."""
        _run("ip", "-n", self._switch, "link", "set", f"v{number}", "down")

    def mend(self, number: int) -> None:
        _run("ip", "-n", self._switch, "link", "set", f"v{number}", "up")

    def command(self, *words: str, host: int = 1) -> list[str]:
        """Return a command that runs on a host, in its file systems."""
        pid = self._sshds[host].pid
        return [
            "nsenter",
            f"--net=/run/netns/{self.namespace(host)}",
            f"--mount=/proc/{pid}/ns/mnt",
            *words,
        ]

    def play_launch(self, *words: str) -> list[str]:
        return self.command(str(Path(sys.executable).with_name("play-launch")), *words)

    @property
    def environment(self) -> dict[str, str]:
        kept = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("PLAY_LAUNCH_", "SSH_"))
            and name != "ROS_AUTOMATIC_DISCOVERY_RANGE"
        }
        return {**kept, "HOME": str(self.home)}

    def pids(self, number: int) -> list[int]:
        done = subprocess.run(
            ["ip", "netns", "pids", self.namespace(number)],
            capture_output=True,
            text=True,
            check=False,
        )
        return [int(each) for each in done.stdout.split()]

    def down(self) -> None:
        for number in range(1, self.count + 1):
            for _ in range(50):
                pids = self.pids(number)
                for pid in pids:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                if not pids:
                    break
                time.sleep(0.05)
        for process in self._sshds.values():
            process.wait()
        for name in (*map(self.namespace, range(1, self.count + 1)), self._switch):
            subprocess.run(["ip", "netns", "del", name], check=False)


@contextlib.contextmanager
def hosts(folder: Path, count: int) -> Iterator[Hosts]:
    made = Hosts(folder, count)
    try:
        made.up()
        yield made
    finally:
        made.down()


def _run(*words: str) -> None:
    subprocess.run(words, check=True, stdin=subprocess.DEVNULL)
