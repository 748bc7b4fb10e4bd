"""One control group: name, limits, processes, events. Every call takes well below a millisecond."""

from __future__ import annotations

import hashlib
import os
import re
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch import UserError
from play_launch.config.resources import NO_LIMIT, NO_LIMITS, GroupLimits, cpu_text, cpus_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

SUPERVISOR: Final = "play-launch-supervisor"
CONTAINER: Final = "container"
DELEGATION_FIX: Final = (
    "systemd-run --user --scope -p Delegate=yes play-launch ... (by root without --user), "
    "Delegate=yes in the systemd unit, or a base_path; in Docker and Podman see docs/resources.md"
)
_CONTROLLER_FIX: Final = (
    "Delegate=cpu cpuset io memory pids in a drop-in of user@.service or in the unit of "
    "play-launch; for other causes see docs/resources.md#where-they-are-made"
)
_SESSION: Final = re.compile(r"play-launch-([0-9]+)-([0-9]+)-([0-9]+)", re.ASCII)
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9_~:\[\]-]")
_NAME_LIMIT: Final = 200
"""Bytes; names of folders have 255, and an attempt follows."""
_PAUSE: Final = 0.002
"""Seconds between two attempts to remove a group whose processes are exiting."""
_UNITS: Final = (
    *(("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)),
    *(("GB", 10**9), ("MB", 10**6), ("kB", 10**3), ("B", 1)),
)


class GroupError(UserError):
    """Control groups, or requested controllers, are missing; the text has cause and fix."""


class SessionName(Struct, frozen=True):
    """Supervisor of a session: its PID namespace by inode, its pid and start time in there."""

    namespace: int
    pid: int
    start_time: int
    """Clock ticks after boot."""

    def __str__(self) -> str:
        return f"play-launch-{self.namespace}-{self.pid}-{self.start_time}"

    @classmethod
    def parsed(cls, name: str) -> SessionName | None:
        """Parse the result of `str`; None for any other name."""
        found = _SESSION.fullmatch(name)
        return cls(*map(int, found.groups())) if found else None


def group_name(full_name: str) -> str:
    """Return the unique name of a member's group; without dots, unlike files of the kernel."""
    name = _UNSAFE.sub(lambda each: f"%{ord(each[0]):x};", full_name.lstrip("/").replace("/", ":"))
    if len(name) > _NAME_LIMIT:
        digest = hashlib.blake2b(name.encode(), digest_size=8).hexdigest()
        name = f"{name[: _NAME_LIMIT - 17]}+{digest}"
    return name or "_"


class Group:
    """A folder of the hierarchy, with the limits for it; `on_end` is called by `retire`."""

    def __init__(
        self,
        path: Path,
        limits: GroupLimits = NO_LIMITS,
        on_end: Callable[[Group], None] = lambda _: None,
    ) -> None:
        self.path = path
        self.limits = limits
        self._on_end = on_end

    def make(self) -> None:
        """Create the folder and those above it, unless they exist; raises GroupError."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            text = f"the control group {self.path} cannot be made: {error.strerror}"
            raise GroupError(f"{text}; fix: {DELEGATION_FIX}") from None

    def enable(self, controllers: Iterable[str], *, top: Path) -> Iterator[str]:
        """Enable controllers for the groups below, from `top` on downwards; yields refusals."""
        missing = frozenset(controllers) - self._words("cgroup.subtree_control")
        if (above := missing - self._words("cgroup.controllers")) and self.path != top:
            yield from Group(self.path.parent).enable(above, top=top)
        available = self._words("cgroup.controllers")
        for controller in sorted(missing):
            if controller not in available:
                if self.path == top:
                    yield _missing(controller, f"is not available in {top}")
                continue
            try:
                self._write("cgroup.subtree_control", f"+{controller}")
            except OSError as error:
                yield _missing(controller, f"cannot be enabled in {self.path}: {error.strerror}")

    def limit(self) -> Iterator[str]:
        """Write the limits whose controllers are enabled; yields refusals."""
        available = self._words("cgroup.controllers")
        for file, value in self.limits.files().items():
            if file.partition(".")[0] not in available:
                continue  # reported when it could not be enabled
            try:
                if file == "cpuset.cpus":
                    existing = cpus_in(Group(self.path.parent).text("cpuset.cpus.effective"))
                    if missing := {*self.limits.cpuset} - existing:
                        yield (
                            f"cpuset {value} has CPUs that this machine, or the group above, has "
                            f"not: there are {cpu_text(existing)}; fix: name those"
                        )
                        value = cpu_text({*self.limits.cpuset} - missing)  # noqa: PLW2901
                self._write(file, value)
            except OSError as error:
                yield (
                    f"{file} cannot be set to {value}: {error.strerror}; fix: leave "
                    "it out on this machine, see docs/resources.md#where-they-are-made"
                )

    @property
    def number(self) -> int:
        """Its inode, which no other group gets; 0 after its removal."""
        with suppress(OSError):
            return self.path.stat().st_ino
        return 0

    def holds(self, pid: int) -> bool:
        """Whether a process, also a zombie, is in this group or one below it."""
        # The path is from the root of the namespace: only its end, from the session on, is ours.
        parts = self.path.parts
        sessions = [index for index, part in enumerate(parts) if SessionName.parsed(part)]
        tail = f"/{'/'.join(parts[sessions[-1] if sessions else -1 :])}/"
        return tail in f"{path_of(pid).removesuffix(' (deleted)')}/"

    def processes(self) -> list[int]:
        """List the processes in it and in the groups below, without zombies."""
        return [pid for folder in _folders(self.path) for pid in Group(folder).residents()]

    def residents(self) -> list[int]:
        """List the processes in it alone, without those of other PID namespaces."""
        try:
            pids = map(int, (self.path / "cgroup.procs").read_text().split())
        except OSError:
            return []
        return [pid for pid in pids if pid]

    def kill(self) -> bool:
        """Kill all of them at once, also what they start meanwhile; False if the kernel cannot."""
        with suppress(OSError):
            self._write("cgroup.kill", "1")
            return True
        return False

    def remove(self) -> bool:
        """Remove the folder and those below it, if without processes; whether it is removed."""
        for folder in [*_folders(self.path)][::-1]:
            with suppress(OSError):
                folder.rmdir()
        return not self.path.exists()

    def retire(self) -> None:
        """Remove the group of an exited member; later, if processes are still exiting."""
        if self.path.is_dir():
            self._on_end(self)
            self.remove()

    def clear(self, seconds: float) -> bool:
        """Kill all processes in it and below, and remove it; blocks. Whether it is removed."""
        deadline = time.monotonic() + seconds
        # More than once: a process may enter a group meanwhile.
        while not self.remove():
            if time.monotonic() > deadline:
                return False
            self.kill()
            time.sleep(_PAUSE)
        return True

    def move_here(self, pids: Iterable[int]) -> None:
        """Move processes into it, without exited ones. Raises OSError."""
        for pid in pids:
            with suppress(ProcessLookupError):
                self._write("cgroup.procs", str(pid))

    def numbers(self, file: str) -> dict[str, int]:
        """Read a file with a name and a number in each line; empty if it is unreadable."""
        pairs = (line.partition(" ") for line in self.text(file).splitlines())
        return {name: int(value) for name, _, value in pairs if value.isdigit()}

    def text(self, file: str) -> str:
        """Read a file of a few lines; empty if it is unreadable."""
        try:
            with open(f"{self.path}/{file}", "rb", buffering=0) as opened:  # noqa: PTH123 - faster
                return opened.read(4096).decode(errors="surrogateescape")
        except OSError:
            return ""

    def _words(self, file: str) -> frozenset[str]:
        return frozenset(self.text(file).split())

    def _write(self, file: str, text: str) -> None:
        # Without a buffer, whose flush would lose the error, or raise it twice.
        descriptor = os.open(self.path / file, os.O_WRONLY | os.O_CLOEXEC)
        try:
            os.write(descriptor, text.encode())
        finally:
            os.close(descriptor)


def path_of(pid: int) -> str:
    """Return the group of a process from the root of the namespace on; empty if unreadable."""
    text = Group(Path("/proc", str(pid))).text("cgroup")
    return next((line[3:] for line in text.splitlines() if line.startswith("0::")), "")


def _folders(path: Path) -> Iterator[Path]:
    """Give a group and those below it, from above to below."""
    yield path
    try:
        below = [Path(each.path) for each in os.scandir(path) if each.is_dir()]
    except OSError:
        return
    for each in below:
        yield from _folders(each)


def _missing(controller: str, why: str) -> str:
    return f"limits of {controller} cannot hold: the controller {why}; fix: {_CONTROLLER_FIX}"


def why_killed(group: Group) -> str:
    """Return the cause of an OOM kill in a group; empty without one."""
    events, limit = group.numbers("memory.events"), group.limits.memory_max
    if not events.get("oom_kill"):
        return ""
    if limit is None or not events.get("oom") or limit == NO_LIMIT:
        return (
            "killed by the kernel: out of memory, not by a limit of its own control group but of "
            "one above, or of the machine"
        )
    # The unit that makes it shortest, which is most likely the one of the configuration.
    sizes = [f"{limit / size:.0f} {unit}" for unit, size in _UNITS if limit % size == 0]
    return f"killed by the kernel: memory.max {min(sizes, key=len)} of its control group"


def why_failed(group: Group) -> str:
    """Return the failures to start processes or threads in a group; empty without any."""
    events = group.numbers("pids.events.local") or group.numbers("pids.events")
    hits, limit = events.get("max", 0), group.limits.pids_max
    if not hits or limit in {None, NO_LIMIT}:
        return ""
    times = "once" if hits == 1 else f"{hits} times"
    return f"pids_max {limit:.0f} of its control group was reached {times}; fix: a larger one"
