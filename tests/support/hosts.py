"""Hosts on this machine: network namespaces on a bridge, each with an ssh server and a /dev/shm.

They share the file system and the pids. Nothing leaves the namespaces.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.support.replay import finished
from tests.support.waiting import until

if TYPE_CHECKING:
    from collections.abc import Iterator

_PROGRAMS = ("ip", "unshare", "nsenter", "ssh-keygen")
_SSHD = "/usr/sbin/sshd"


_BOOT = """\
set -e
umount -l /sys/fs/cgroup || true
mount -t cgroup2 none /sys/fs/cgroup
mkdir -p /sys/fs/cgroup/$1
echo $$ > /sys/fs/cgroup/$1/cgroup.procs
mkdir -p $2
mount -t tmpfs tmpfs $2
mkdir $2/upper $2/work $2/root
mount -t overlay overlay -o lowerdir=/,upperdir=$2/upper,workdir=$2/work $2/root
root=$2/root
cat > $root/lib/systemd/system/host.target <<UNIT
[Unit]
Requires=basic.target dbus.socket systemd-logind.service systemd-user-sessions.service
Wants=ssh.service
After=basic.target
UNIT
rm -f $root/etc/ssh/sshd_not_to_be_run
systemd-id128 new > $root/etc/machine-id
[ -e $2.key ] || ssh-keygen -q -t ed25519 -N "" -C "" -f $2.key
cp $2.key $root/etc/ssh/host_key
cp $3 $root/etc/ssh/authorized_keys
for folder in $4 $5; do
  # The user robot runs what lies there.
  while folder=$(dirname $folder) && [ $folder != / ]; do chmod a+x $root$folder; done
done
chroot $root useradd -m -s /bin/bash robot
mkdir -p $root/var/lib/systemd/linger
[ ! -e $2.linger ] || touch $root/var/lib/systemd/linger/robot
printf '%s\\n' 'HostKey /etc/ssh/host_key' 'UsePAM yes' 'PermitRootLogin yes' 'StrictModes no' \
  'AuthorizedKeysFile /etc/ssh/authorized_keys' 'Subsystem sftp internal-sftp' \\
  > $root/etc/ssh/sshd_config
cp $2.key.pub $2.pub
export SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=1
exec systemd-nspawn -q -D $root --register=no --keep-unit -M $1 --hostname=$1 \
  --network-namespace-path=/run/netns/$1 --bind-ro=$4 --bind-ro=$5 --console=pipe \
  /lib/systemd/systemd systemd.unit=host.target
"""
"""Arguments: name, folder, public key, prefix and base prefix of Python."""


def missing_systemd() -> str:
    """Say what hosts with a systemd need and is not here."""
    if problem := missing():
        return problem
    absent = [] if shutil.which("systemd-nspawn") else ["systemd-nspawn"]
    absent += [each for each in (_SSHD, "/lib/systemd/systemd") if not Path(each).exists()]
    return (
        f"needs {', '.join(absent)} (packages systemd-container, openssh-server)" if absent else ""
    )


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
        self._booted: dict[int, subprocess.Popen[bytes]] = {}
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
            self._network(number)
            known.append(f"10.77.0.{number} {self._sshd(number)}")
            config.append(f"Host h{number}\n  HostName 10.77.0.{number}\n  User root\n")
        (self.home / ".ssh/known_hosts").write_text("\n".join(known) + "\n")
        (self.home / ".ssh/config").write_text("".join(config))
        for number in range(1, self.count + 1):
            self._await_sshd(f"h{number}")

    def _await_sshd(self, host: str) -> None:
        until(lambda: self.ssh(host, "true", code=None) is not None, f"the sshd of {host}")

    def _network(self, number: int) -> None:
        """Make the network namespace of a host, and connect it to the switch."""
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

    def boot(self, number: int) -> None:
        """Boot a host with a systemd of its own, over this machine's files; root and robot log in.

        It is reached as s<number>. A second call is a reboot.
        """
        name, folder = self.namespace(number), self.folder / f"root{number}"
        if number in self._booted:
            self._kill(number)
            self._booted.pop(number).wait()
        else:
            self._network(number)
        with (self.folder / f"boot{number}.log").open("ab") as log:
            self._booted[number] = subprocess.Popen(
                [
                    *("unshare", "-m", "bash", "-c", _BOOT, "bash", name, str(folder)),
                    *(f"{self.home}/.ssh/id_ed25519.pub", sys.prefix, sys.base_prefix),
                ],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        address = f"10.77.0.{number}"
        aliases, known = self.home / ".ssh/config", self.home / ".ssh/known_hosts"
        if f"Host s{number}\n" not in aliases.read_text():
            aliases.write_text(f"{aliases.read_text()}Host s{number}\n  HostName {address}\n")
            key = folder.with_suffix(".pub")
            until(key.exists, "its host key")
            known.write_text(f"{known.read_text()}{address} {key.read_text()}")
        self._await_sshd(f"root@s{number}")

    def ssh(self, host: str, command: str, code: int | None = 0) -> str | None:
        """Run a command on a host; with ``code`` None, return None where that fails."""
        done = subprocess.run(
            self.command(
                *("ssh", "-F", f"{self.home}/.ssh/config", "-o", "BatchMode=yes"),
                *("-i", f"{self.home}/.ssh/id_ed25519", "-o", "ConnectTimeout=1"),
                *("-o", f"UserKnownHostsFile={self.home}/.ssh/known_hosts", host, command),
            ),
            env=self.environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert code in {None, done.returncode}, f"{command}: {done.stdout}{done.stderr}"
        return done.stdout if done.returncode == 0 else None

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

    def run(self, *words: str, code: int | None = None) -> subprocess.CompletedProcess[str]:
        """Run play-launch on h1 to its end; with ``code``, it has to exit with that."""
        return finished(self.play_launch(*words), env=self.environment, timeout=60, code=code)

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

    def _kill(self, number: int) -> None:
        def nothing_left() -> bool:
            pids = self.pids(number)
            for pid in pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            return not pids

        until(nothing_left, f"the end of host {number}")

    def down(self) -> None:
        numbers = [*range(1, self.count + 1), *self._booted]
        for number in numbers:
            self._kill(number)
        for process in (*self._sshds.values(), *self._booted.values()):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            process.wait()
        for name in (*map(self.namespace, numbers), self._switch):
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


class Running:
    """A coordinator and what it prints."""

    def __init__(self, net: Hosts, config: Path) -> None:
        self.net = net
        self.name = config.stem
        self.output = config.with_suffix(".out")
        with self.output.open("ab") as out:
            self.process = subprocess.Popen(
                net.play_launch("replay", "--json", str(config)),
                env=net.environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def ask(self, *words: str, code: int = 0) -> str:
        done = subprocess.run(
            self.net.play_launch(*words, "--session", str(self.process.pid)),
            env=self.net.environment,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == code, f"{words}: {done.stdout}{done.stderr}{self.printed()}"
        return done.stdout + done.stderr

    def loaded(self) -> Running:
        self.ask("wait", "--timeout", "40s")
        return self

    def rows(self) -> dict[str, dict[str, Any]]:
        return {row["name"]: row for row in json.loads(self.ask("ps", "--json"))}

    def printed(self) -> str:
        return self.output.read_text()

    def events(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.printed().splitlines() if line.startswith("{")]

    def ticks(self) -> list[int]:
        """Give the numbers that the process on h3 wrote, as they were printed."""
        texts = (each["text"] for each in self.events() if each["event"] == "output")
        return [int(found[1]) for text in texts if (found := re.fullmatch(r"tick (\d+)", text))]

    def stop(self, code: int = 130) -> None:
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(40) == code, self.printed()


@contextlib.contextmanager
def running(net: Hosts, config: Path) -> Iterator[Running]:
    started = Running(net, config)
    try:
        yield started
    finally:
        if started.process.poll() is None:
            started.process.send_signal(signal.SIGINT)
            try:
                started.process.wait(30)
            except subprocess.TimeoutExpired:
                started.process.kill()
                started.process.wait()
