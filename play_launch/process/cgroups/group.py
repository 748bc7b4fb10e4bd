"""One control group: made, limited, killed, removed. Every call takes well below a millisecond."""

from __future__ import annotations

import os
import select
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.config.resources import NO_LIMITS, GroupLimits, cpu_text, cpus_in
from play_launch.process.cgroups.base import GroupError
from play_launch.process.cgroups.controllers import lack_of
from play_launch.process.cgroups.marks import enabled_for_us, forget_enabled, note_enabled
from play_launch.process.cgroups.names import SessionName
from play_launch.process.cgroups.refusals import (
    fewer_cpus,
    no_controller,
    no_group,
    no_limit,
    unavailable_controller,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

_PAUSE: Final = 0.001
_MOST: Final = 65536
"""Bytes; no file with numbers is longer."""


class Group:
    """A folder of the hierarchy."""

    def __init__(
        self,
        path: Path,
        limits: GroupLimits = NO_LIMITS,
        on_end: Callable[[Group], None] = lambda _: None,
    ) -> None:
        """Know a group.

        Args:
            path: Its folder.
            limits: What is to hold in it.
            on_end: Is called before it is removed as `retire` does.
        """
        self.path = path
        self.limits = limits
        self._on_end = on_end

    def make(self) -> None:
        """Make the folder, unless it is there; raises GroupError."""
        try:
            self.path.mkdir(exist_ok=True)
        except OSError as error:
            raise GroupError(no_group(self.path, error)) from None

    def enable(self, controllers: Iterable[str], *, top: Path) -> Iterator[str]:
        """Enable controllers for the groups below, from `top` on downwards.

        Yields what was refused, with the fix.
        """
        wanted = frozenset(controllers)
        if not wanted - self._words("cgroup.subtree_control"):
            return
        if (missing := wanted - self._words("cgroup.controllers")) and self.path != top:
            yield from Group(self.path.parent).enable(missing, top=top)
        there = self._words("cgroup.controllers")
        for controller in sorted(wanted - self._words("cgroup.subtree_control")):
            if controller not in there:
                if self.path == top:
                    yield unavailable_controller(controller, self.path, lack_of(controller))
                continue
            try:
                self._write("cgroup.subtree_control", f"+{controller}")
            except OSError as error:
                yield no_controller(controller, self.path, error)
            else:
                note_enabled(self.path, controller)

    def disable(self, controllers: Iterable[str]) -> None:
        """Take controllers from the groups below, as far as the kernel agrees."""
        for controller in controllers:
            with suppress(OSError):
                self._write("cgroup.subtree_control", f"-{controller}")

    def disable_ours(self) -> None:
        """Take those from the groups below that a session of ours has enabled."""
        self.disable(enabled_for_us(self.path))
        forget_enabled(self.path)

    @property
    def enabled(self) -> frozenset[str]:
        """The controllers of the groups below."""
        return self._words("cgroup.subtree_control")

    def limit(self) -> Iterator[str]:
        """Write the limits whose controllers there are; yields what was refused, with the fix."""
        there = self._words("cgroup.controllers")
        for file, value in self.limits.files().items():
            if file.partition(".")[0] not in there:
                continue  # reported when it could not be enabled
            if file == "cpuset.cpus":
                value, problem = self._cpus(self.limits.cpuset)  # noqa: PLW2901
                if problem:
                    yield problem
                if not value:
                    continue
            try:
                self._write(file, value)
            except OSError as error:
                yield no_limit(file, value, error)

    def _cpus(self, wanted: tuple[int, ...]) -> tuple[str, str]:
        """Give those of the CPUs that are there, and what is to be said of the others."""
        try:
            there = cpus_in((self.path.parent / "cpuset.cpus.effective").read_text())
        except (OSError, ValueError):
            return cpu_text(wanted), ""
        if there.issuperset(wanted):
            return cpu_text(wanted), ""
        left = there.intersection(wanted)
        return cpu_text(left), fewer_cpus(cpu_text(wanted), cpu_text(there))

    @property
    def number(self) -> int:
        """Its number in the kernel, which no other group gets; 0 when it is removed."""
        try:
            return self.path.stat().st_ino
        except OSError:
            return 0

    def holds(self, pid: int) -> bool:
        """Whether a process, or what is left of it, is in this group or one below it."""
        try:
            text = Path("/proc", str(pid), "cgroup").read_text()
        except OSError:
            return False
        # The path is from the root of the namespace: its end is that of ours.
        own = next((line[3:] for line in text.splitlines() if line.startswith("0::")), "")
        return f"{own.removesuffix(' (deleted)')}/".find(self._tail) >= 0

    @property
    def _tail(self) -> str:
        # From the folder of the session on, whose name is unique: what is above it looks different
        # from within a namespace.
        parts = self.path.parts
        sessions = [index for index, part in enumerate(parts) if SessionName.parsed(part)]
        return f"/{'/'.join(parts[sessions[-1] if sessions else -1 :])}/"

    def processes(self) -> list[int]:
        """List the processes in it and in the groups below; zombies are none."""
        return [pid for folder in _folders(self.path) for pid in Group(folder).residents()]

    def residents(self) -> list[int]:
        """List the processes in it alone; those of other PID namespaces are left out."""
        try:
            pids = map(int, (self.path / "cgroup.procs").read_text().split())
        except OSError:
            return []
        return [pid for pid in pids if pid]

    def kill(self) -> bool:
        """Kill all of them at once, also what they start meanwhile; False: the kernel cannot."""
        try:
            self._write("cgroup.kill", "1")
        except OSError:
            return False
        return True

    def wait_empty(self, seconds: float) -> bool:
        """Wait until no process is left in it or below; blocks. Whether that is so."""
        deadline = time.monotonic() + seconds
        try:
            events = os.open(self.path / "cgroup.events", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return not self.path.exists()
        try:
            poll = select.poll()
            poll.register(events, select.POLLPRI)
            while b"populated 1" in os.pread(events, 256, 0):
                left = deadline - time.monotonic()
                if left <= 0:
                    return False
                poll.poll(left * 1000)
        except OSError:  # it is removed
            return True
        finally:
            os.close(events)
        return True

    def remove(self) -> bool:
        """Remove the folder and those below it, without processes; whether it is removed."""
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
        """Kill what is in it and below, and remove it all; blocks. Whether it is gone."""
        deadline = time.monotonic() + seconds
        # More than once: a process may enter a group meanwhile.
        while not self.remove():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self.kill()
            if self.wait_empty(left):
                time.sleep(_PAUSE)  # the kernel may still be busy with the last of them
        return True

    def move_here(self, pids: Iterable[int]) -> None:
        """Move processes into it; those that have ended are left out. Raises OSError."""
        for pid in pids:
            with suppress(ProcessLookupError):
                self._write("cgroup.procs", str(pid))

    def numbers(self, file: str) -> dict[str, int]:
        """Read a file with a name and a number in each line; empty where it is not there."""
        pairs = (line.partition(" ") for line in self.text(file).splitlines())
        return {name: int(value) for name, _, value in pairs if value.isdigit()}

    def text(self, file: str) -> str:
        """Read a file in three system calls; empty where it is not there, or cannot be read."""
        try:
            descriptor = os.open(f"{self.path}/{file}", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return ""
        try:
            return os.read(descriptor, _MOST).decode()
        except OSError:  # the group is being removed
            return ""
        finally:
            os.close(descriptor)

    def _words(self, file: str) -> frozenset[str]:
        try:
            return frozenset((self.path / file).read_text().split())
        except OSError:
            return frozenset()

    def _write(self, file: str, text: str) -> None:
        # Not through a buffer: its flush would lose the error, or raise it twice.
        descriptor = os.open(self.path / file, os.O_WRONLY | os.O_CLOEXEC)
        try:
            os.write(descriptor, text.encode())
        finally:
            os.close(descriptor)


def _folders(path: Path) -> Iterator[Path]:
    """Give a group and those below it, from above to below."""
    yield path
    try:
        below = [Path(each.path) for each in os.scandir(path) if each.is_dir()]
    except OSError:
        return
    for each in below:
        yield from _folders(each)
