"""What is brought to a machine: the files of its part, and the commands that use them."""

from __future__ import annotations

import asyncio
import hashlib
import io
import json
import logging
import os
import shlex
import tarfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.config.machines import PARTS, Service
from play_launch.control.protocol import PROTOCOL
from play_launch.deploy.machines.hosts import HostError
from play_launch.deploy.unit import stop_seconds
from play_launch.recording.environment import OURSELVES, package_version

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.deploy.machines.hosts import Host

_log = logging.getLogger(__name__)
_ANY_HASH: Final = "?" * 16
_KEPT: Final = 6
"""One more than the copies of a part that stay on its machine."""
BUSY: Final = "a session of this part is being started already"
_LARGEST: Final = 512 * 1024 * 1024
"""Bytes that are copied."""


def files_of(config: ReplayConfig, copy: Iterable[Path]) -> dict[str, bytes]:
    """Return the files of a configuration, and those to copy, by path; raises HostError.

    What `find-pkg-share` found is left out: it is found there anew, in the package of that place.
    """
    source = config.source.absolute()
    files = {str(source): config.text}
    packages = [Path(each) for each in config.taken.packages.values()]
    elsewhere = [each for each in packages if not source.is_relative_to(each)]
    for file in (*config.included_files, *config.parameter_files):
        path = Path(os.path.normpath(file.path.absolute()))
        if not any(map(path.is_relative_to, elsewhere)):
            files[str(path)] = file.text
    size = 0
    for path in (each for folder in copy for each in _files_below(folder)):
        try:
            size += path.stat().st_size
            if size > _LARGEST:
                raise HostError(f"copy: more than {_LARGEST >> 20} MiB; copy it beforehand")
            files[str(path)] = path.read_bytes()
        except OSError as error:
            raise HostError(f"copy: {path}: {error.strerror}") from None
    return files


def _files_below(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise HostError(f"copy: there is no {path}")
    return sorted(each for each in path.rglob("*") if each.is_file())


def _mode(name: str) -> int:
    return 0o700 if os.access(name, os.X_OK) else 0o600


def _archive(contents: Mapping[str, bytes]) -> bytes:
    """Pack files for tar(1); below ``files`` stands their path here, and they can be programs."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for name, content in contents.items():
            about = tarfile.TarInfo(name)
            path = name.removeprefix("files")
            about.size, about.mode = len(content), _mode(path) if path != name else 0o600
            archive.addfile(about, io.BytesIO(content))
    return buffer.getvalue()


class Bundle:
    """The part of a machine, in a folder that is named by its content."""

    def __init__(
        self,
        part: ReplayConfig,
        arguments: tuple[str, ...],
        files: Mapping[str, bytes],
        *,
        home: str,
        program: str,
        peers: Sequence[str],
    ) -> None:
        """Name the folder; ``home`` is of the machine, ``program`` is the local play-launch."""
        self._part = part
        self.machine = part.machines[part.machine]
        self.arguments = arguments
        self._program = program
        self._peers = peers
        digest = hashlib.sha256(json.dumps(list(arguments)).encode())
        for name in sorted(files):
            digest.update(f"{name}\0{len(files[name])}\0{_mode(name)}\0".encode())
            digest.update(files[name])
        self._hash = digest.hexdigest()[:16]
        kept = (each if each.isascii() and each.isalnum() else "-" for each in part.name)
        self.unit = f"{''.join(kept)}-{part.machine}"
        self.folder = f"{home}/{PARTS}/{self.unit}-{self._hash}"
        source = str(part.source.absolute())
        self.source = source if self.machine.local else f"{self.folder}/files{source}"
        """Path of the configuration there."""

    def start_script(self) -> str:
        duration = self._part.duration  # of the command line, perhaps
        limit = "" if duration is None else f" --duration {duration}"
        return self.script(f"replay --quiet{limit}", lock=True)

    async def bring(self, host: Host, files: Mapping[str, bytes]) -> None:
        """Copy it there, unless it is there; raises HostError and LinkLost."""
        folder = shlex.quote(self.folder)
        complete = f"{folder}/complete"
        found = await host.run(f"umask 077; mkdir -p {folder}; test -e {complete}")
        # The variables of the machine are in it.
        contents = {"start.sh": self.start_script().encode()}
        if found.status and not self.machine.local:
            contents |= {f"files{path}": text for path, text in files.items()}
        unpack = f"umask 077; tar -xmof - -C {folder} && touch {complete} || exit 1"
        archive = await asyncio.to_thread(_archive, contents)
        done = await host.run(f"{unpack}\n{self.clean_up_command()}\ntrue", None, archive)
        if done.status:
            raise HostError(f"files cannot be written there: {done.stderr or done.stdout}")

    def clean_up_command(self) -> str:
        """Return a command that removes earlier copies, all but a few, and those in use."""
        # Processes may run in one that is not the latest.
        places = "readlink /proc/[0-9]*/cwd 2> /dev/null"
        names = f"""{places} | sed -n "s|^$(pwd -P)/\\([^/]*\\)/.*|\\1|p\""""
        return (
            f'cd "$HOME/{PARTS}" && ls -dt {self.unit}-{_ANY_HASH} '
            f'| grep -vxF "$(readlink {self.unit}; {names})" | tail -n +{_KEPT} | xargs -r rm -rf'
        )

    def adopt_command(self) -> str:
        """Return a command by which this is what is started from now on, by systemd as well."""
        return f'cd "$HOME/{PARTS}" && ln -sfn {self.unit}-{self._hash} {self.unit}'

    def script(self, command: str, *, lock: bool = False) -> str:
        """Write a script that becomes a play-launch of the part, in the machine's environment.

        With ``lock`` it ends at once where another one of the part runs, which may be so young that
        it cannot be found yet: the connection was lost while it was started.
        """
        lines = ["#!/bin/bash"]
        if lock:
            file = shlex.quote(f"{self.folder.removesuffix(self._hash)}lock")
            lines.append(f"exec 9> {file} && flock -n 9 || {{ echo {shlex.quote(BUSY)}; exit 0; }}")
        program = (
            shlex.quote(self._program) if self.machine.local else _path(self.machine.play_launch)
        )
        words = ["--machine", self.machine.name, self.source, *self.arguments]
        lines += [
            *self.environment_lines(),
            f"cd {shlex.quote(os.path.dirname(self.source))}",  # noqa: PTH120
            f"exec {program} {command} {shlex.join(words)}",
        ]
        return "\n".join(lines) + "\n"

    def environment_lines(self) -> list[str]:
        """Return the lines of a script that make the machine's environment."""
        lines = [f". {_path(file)} || exit 3" for file in self.machine.setup]
        variables = dict(self.machine.environment)
        if self._peers:
            variables.setdefault("ROS_STATIC_PEERS", ";".join(self._peers))
        lines += [f"export {name}={shlex.quote(value)}" for name, value in variables.items()]
        return lines

    def start_command(self) -> str:
        adopted = self.folder.removesuffix(f"-{self._hash}")
        names = ("start.sh", "output", "status")
        script, output, status = (shlex.quote(f"{adopted}/{name}") for name in names)
        bash = f"bash --norc --noprofile {script}"
        if self.machine.local or self.machine.service is Service.NONE:
            run = f"{bash} < /dev/null > {output} 2>&1; echo $? > {status}"
            return f"rm -f {status}; setsid bash -c {shlex.quote(run)} > /dev/null 2>&1 & echo $!"
        user = "--user " if self.machine.service is Service.USER else ""
        settings = {
            "Type": "notify",
            "NotifyAccess": "main",
            "KillMode": "mixed",
            "TimeoutStopSec": str(stop_seconds(self._part)),
            "Delegate": "yes",
            "Restart": "on-failure",
            "RestartSec": "1",
            "SuccessExitStatus": "129 130 143",
            "RestartPreventExitStatus": "2",
        }
        words = " ".join(f"-p {shlex.quote(f'{key}={value}')}" for key, value in settings.items())
        return (
            f"systemd-run {user}--quiet --collect --no-block --unit=play-launch-{self.unit} "
            f"{words} "
            f'-E HOME="$HOME" {bash}'
        )


def _path(path: str) -> str:
    """Quote a path of another machine; ~ is the home folder there."""
    if path.startswith("~/"):
        return f'"$HOME"/{shlex.quote(path[2:])}'
    return shlex.quote(path)


async def require_fit(host: Host, bundle: Bundle) -> None:
    """Let a machine check its part; raises HostError with what to do, and LinkLost."""
    output = await host.run(bundle.script("check --json"))
    try:
        found = json.loads(output.stdout)
    except ValueError:
        reason = output.stderr or output.stdout or "no output"
        if output.status == 127:
            reason += "; install play-launch there, or give its path as play_launch"
        raise HostError(f"play-launch cannot be run there: {reason}") from None
    if not found["valid"]:
        problems = [
            f"{each['location']['file']}:{each['location']['line']}: {each['message']}"
            for each in found["problems"]
        ]
        raise HostError("the configuration cannot be used there:\n  " + "\n  ".join(problems))
    if found.get("protocol") != PROTOCOL:
        raise HostError(
            f"its play-launch uses protocol {found.get('protocol')}, and this one {PROTOCOL}; "
            "install the same version"
        )
    machine = bundle.machine
    if (version := found.get("version", "older")) != (ours := package_version(OURSELVES)):
        _log.warning("%s: its play-launch is %s, and this one %s", machine.name, version, ours)
    if machine.service is Service.USER and not machine.local:
        await _require_user_service(host, machine.ssh or machine.name)


async def _require_user_service(host: Host, name: str) -> None:
    output = await host.run(
        "systemctl --user show-environment > /dev/null && "
        'loginctl show-user "$(id -un)" -p Linger --value'
    )
    if output.status:
        raise HostError(
            f"it has no systemd manager for this user ({output.stderr or 'no answer'}): "
            f"give service: none, or service: system"
        )
    if output.stdout.strip() != "yes":
        raise HostError(
            "systemd would stop the session after this login; run once: "
            f"ssh {name} loginctl enable-linger (as another user: with sudo and the name)"
        )
