"""The hosts of the tests: those of the demo, with OpenSSH's server and systemd where installed."""

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
from typing import TYPE_CHECKING, Any, Self

import psutil

from play_launch.deploy.machines.namespaces import Namespaces, missing
from tests.support.replay import COMMAND, finished
from tests.support.waiting import until

if TYPE_CHECKING:
    from collections.abc import Iterator

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
binds=
for folder in $4 $5; do
  # What is on another file system than / is not in the overlay.
  [ -e $root$folder/bin ] || binds="$binds --bind-ro=$folder"
  # The user robot runs what lies there.
  while folder=$(dirname $folder) && [ $folder != / ]; do chmod a+x $root$folder; done
done
chroot $root useradd -m -s /bin/bash robot
[ ! -e $2.disk ] || cp -a $2.disk/. $root
printf '%s\\n' 'HostKey /etc/ssh/host_key' 'UsePAM yes' 'PermitRootLogin yes' 'StrictModes no' \
  'AuthorizedKeysFile /etc/ssh/authorized_keys' 'Subsystem sftp internal-sftp' \\
  > $root/etc/ssh/sshd_config
cp $2.key.pub $2.pub
export SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=1
exec systemd-nspawn -q -D $root --register=no --keep-unit -M $1 --hostname=$1 \
  --network-namespace-path=/run/netns/$1 $binds --console=pipe \
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


class Hosts(Namespaces):
    """Hosts h1, h2, ...; commands run on h1, as if a person sat there."""

    def __init__(self, folder: Path, count: int) -> None:
        super().__init__(folder, count)
        self._booted: dict[int, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        super().__enter__()
        for number in range(1, self.count + 1):
            self._await_sshd(f"h{number}")
        return self

    def _await_sshd(self, host: str) -> None:
        until(lambda: self.ssh(host, "true", code=None) is not None, f"the sshd of {host}")

    def server_command(self, folder: Path, home: Path) -> list[str]:
        if not Path(_SSHD).exists():
            return super().server_command(folder, home)
        (folder / "sshd_config").write_text(
            f"Port 22\nHostKey {folder}/hostkey\nPidFile none\n"
            f"AuthorizedKeysFile {self.home}/.ssh/id_ed25519.pub\n"
            "PasswordAuthentication no\nUsePAM no\nStrictModes no\nPermitRootLogin yes\n"
            f"Subsystem sftp internal-sftp\nSetEnv HOME={home}\n"
        )
        server = f"exec {_SSHD} -D -e -f {folder}/sshd_config"
        return ["bash", "-c", f"echo runs; {server}"]

    def set_multicast(self, state: str) -> None:
        """Let the switch carry multicast (`on`), or not (`off`)."""
        for number in range(1, self.count + 1):
            words = ("link", "set", f"v{number}", "type", "bridge_slave", "mcast_flood", state)
            subprocess.run(["ip", "-n", self._switch, *words], check=True)

    def boot(self, number: int) -> None:
        """Boot a host with a systemd of its own, over this machine's files; root and robot log in.

        It is reached as s<number>. A second call is a reboot: of what was written on the host,
        only what lies in the folder root<number>.disk is there again.
        """
        name, folder = self.namespace(number), self.folder / f"root{number}"
        if number in self._booted:
            self.kill(number)
            self._booted.pop(number).wait()
        else:
            self.make_network(number)
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

    def play_launch(self, *words: str, host: int = 1) -> list[str]:
        return self.command(str(COMMAND), *words, host=host)

    def run(self, *words: str, code: int | None = None) -> subprocess.CompletedProcess[str]:
        """Run play-launch on h1 to its end; with ``code``, it has to exit with that."""
        return finished(self.play_launch(*words), env=self.environment, timeout=60, code=code)

    def remove(self) -> None:
        super().remove()
        for booted in self._booted.values():
            booted.wait()


class Running:
    """A coordinator, or the only supervisor of a system, and what it prints."""

    def __init__(self, net: Hosts, config: Path, host: int = 1) -> None:
        self.net, self.host = net, host
        self.name = config.stem
        self.output = config.with_suffix(".out")
        with self.output.open("ab") as out:
            self.process = subprocess.Popen(
                net.play_launch("replay", "--json", str(config), host=host),
                env=net.environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def ask(self, *words: str, code: int | None = 0) -> str:
        done = subprocess.run(
            self.net.play_launch(*words, "--session", str(self.process.pid), host=self.host),
            env=self.net.environment,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert code in {None, done.returncode}, (
            f"{words}: {done.stdout}{done.stderr}{self.printed()}"
        )
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


def system(
    folder: Path, name: str, *, more: str = "", h3: str = "", talker: str = "talker"
) -> Path:
    path = folder / f"{name}.yaml"
    path.write_text(
        f"""\
version: 1
name: {name}
{more}
environment:
  ROS_AUTOMATIC_DISCOVERY_RANGE: SUBNET
  ROS_DOMAIN_ID: "{os.environ.get("ROS_DOMAIN_ID", "7")}"
  PLAY_LAUNCH_LOG_DIR: {folder}/log
machines:
  main: {{local: true}}
  h2: {{service: none, play_launch: {COMMAND}, lost_after: 1 s}}
  h3: {{service: none, play_launch: {COMMAND}, lost_after: 1 s{h3}}}
containers:
  - name: talk
    machine: h2
    container_type: isolated
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: {talker}}}
  - name: listen
    machine: h3
    container_type: isolated
    depends_on: [talk]
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}}
nodes:
  - {{name: clock, command: [sleep, "1000"]}}
  - name: ticks
    machine: h3
    command: [bash, -c, "i=0; while :; do echo tick $((i += 1)); read -t 0.05 <> <(:); done"]
"""
    )
    return path


def supervisors(net: Hosts, number: int) -> list[int]:
    """Their pids, without those of children that are about to execute something else."""
    parents = {}
    for pid in net.pids(number):
        with contextlib.suppress(OSError, psutil.Error):  # it has ended meanwhile
            if b"\0--machine\0" in Path(f"/proc/{pid}/cmdline").read_bytes():
                parents[pid] = psutil.Process(pid).ppid()
    return [pid for pid, parent in parents.items() if parent not in parents]
