"""The environment of containers and nodes: where ROS is, what is preloaded, which allocator."""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.container.ros import RosSource
from play_launch.ros.fastdds.middleware import asks_for_fastdds

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from play_launch.container.ros import RosInstallation

BOOTSTRAP_MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Set by the wheels' start-up hook once LD_LIBRARY_PATH holds what they need.

We hand the mark on to children of our own environment, because the LD_LIBRARY_PATH that goes
with it is complete: without it each Python there would start twice (16 ms), and the hook would
write the folders in an order that changes with every start. It must not reach a Python of another
environment, see `foreign_python_environment`.
"""

_DEFAULTS = {
    # Lines, not blocks: a line that stays in a buffer is lost when its process is killed.
    "RCUTILS_LOGGING_BUFFERED_STREAM": "0",
    # Our output is read by a program, which puts colour on it itself.
    "RCUTILS_COLORIZED_OUTPUT": "0",
    # The same for print() in nodes written in Python; others take no notice.
    "PYTHONUNBUFFERED": "1",
}
_COERCED = {"C.UTF-8", "C.utf8", "UTF-8"}
"""What Python sets LC_CTYPE to in the C locale, see PEP 538."""
_PYTHON = re.compile(r"python(\d+(\.\d+)*)?")


def child_environment(
    base: Mapping[str, str],
    ros: RosInstallation,
    declared: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Make the environment of a child.

    Our prefix comes first in AMENT_PREFIX_PATH, our libraries first in LD_LIBRARY_PATH; with
    wheels our programs are in PATH, so that `python3` is the one that has rclpy even if the
    environment was not activated.

    Args:
        base: The environment to start from, usually our own.
        ros: Which ROS this is.
        declared: What the configuration says; it wins over everything else.
    """
    environment = {**_DEFAULTS, **base}
    _prepend(environment, "LD_LIBRARY_PATH", ros.library_dirs)
    _prepend(environment, "AMENT_PREFIX_PATH", [ros.prefix])
    if ros.source is RosSource.WHEELS:
        programs = os.fspath(ros.prefix / "bin")
        if programs not in environment.get("PATH", "").split(os.pathsep):
            _prepend(environment, "PATH", [ros.prefix / "bin"])
        environment[BOOTSTRAP_MARK] = "1"
    environment.update(declared or {})
    return environment


def foreign_python_environment(
    environment: Mapping[str, str], ros: RosInstallation, program: Path
) -> dict[str, str]:
    """Undo our wheels for a Python of another environment, which must find its own.

    Such a Python would take the mark for its own, skip its start-up hook and load our libraries
    under its modules. Everything else, and every other program, keeps the environment.

    Args:
        environment: What `child_environment` made.
        ros: Which ROS this is.
        program: The interpreter as it will be executed, found in PATH and not resolved: the
            programs of most environments are symbolic links to one Python.
    """
    changed = dict(environment)
    is_python = _PYTHON.fullmatch(program.name) is not None
    if ros.source is RosSource.SYSTEM or not is_python or program.is_relative_to(ros.prefix):
        return changed
    changed.pop(BOOTSTRAP_MARK, None)
    _remove(changed, "LD_LIBRARY_PATH", ros.library_dirs)
    _remove(changed, "AMENT_PREFIX_PATH", [ros.prefix])
    return changed


def caller_environment(environment: Mapping[str, str], ros: RosInstallation) -> dict[str, str]:
    """Undo in our own environment what was put into it while this Python came up.

    What the caller had set to the same is undone as well.
    """
    changed = dict(environment)
    if changed.get("LC_CTYPE") in _COERCED:
        del changed["LC_CTYPE"]
    if changed.pop(BOOTSTRAP_MARK, None) is not None:
        _remove(changed, "LD_LIBRARY_PATH", ros.library_dirs)
    return changed


def _prepend(environment: dict[str, str], name: str, paths: Iterable[Path]) -> None:
    present = [entry for entry in environment.get(name, "").split(os.pathsep) if entry]
    entries = dict.fromkeys([*map(os.fspath, paths), *present])
    environment[name] = os.pathsep.join(entries)


def _remove(environment: dict[str, str], name: str, paths: Iterable[Path]) -> None:
    unwanted = {os.fspath(path) for path in paths}
    entries = [entry for entry in environment.get(name, "").split(os.pathsep) if entry]
    kept = [entry for entry in entries if entry not in unwanted]
    if kept:
        environment[name] = os.pathsep.join(kept)
    else:
        environment.pop(name, None)


_PRELOAD: Final = "LD_PRELOAD"
WAITS_SWITCH: Final = "PLAY_LAUNCH_FASTDDS_WAITS"
"""Environment variable: with 0 a process gets Fast DDS as it is."""
_WAITS_LIBRARY: Final = "libfastdds_waits.so"
"""Beside the container's program; which functions it has, and why: docs/overrides.md."""
_ASAN_OPTIONS: Final = "ASAN_OPTIONS"
_ANY_ORDER: Final = "verify_asan_link_order=0"
"""Else a program with GCC's AddressSanitizer refuses to start behind a preloaded library. Only what
defines functions that the sanitizer has, too, must not come before it."""


def preloaded_in(environment: Mapping[str, str]) -> list[str]:
    """Give what is preloaded, first things first, as it is written there."""
    return [name for name in re.split(r"[: ]", environment.get(_PRELOAD, "")) if name]


def preloading(
    environment: Mapping[str, str], library: Path, *, last: bool = False
) -> dict[str, str]:
    """Add a library to what is preloaded, as the first one unless it may come last."""
    changed = dict(environment)
    entry = os.fspath(library)
    if " " in entry:
        # The name ends there, but a virtual environment may be in such a folder. A name without
        # a slash is searched for.
        searched = [os.fspath(library.parent), *filter(None, [changed.get("LD_LIBRARY_PATH")])]
        changed["LD_LIBRARY_PATH"] = os.pathsep.join(searched)
        entry = library.name
    names = [name for name in preloaded_in(changed) if name != entry]
    changed[_PRELOAD] = ":".join([*names, entry] if last else [entry, *names])
    return changed


def with_safe_waits(environment: Mapping[str, str], container: Path) -> dict[str, str]:
    """Keep a process from waiting for itself in Fast DDS; ``container`` is our own program.

    With another middleware, or where the switch is 0, nothing is changed.
    """
    if not asks_for_fastdds(environment) or environment.get(WAITS_SWITCH) == "0":
        return dict(environment)
    changed = preloading(environment, container.with_name(_WAITS_LIBRARY), last=True)
    others = changed.get(_ASAN_OPTIONS, "").removeprefix(_ANY_ORDER).removeprefix(":")
    changed[_ASAN_OPTIONS] = f"{_ANY_ORDER}:{others}" if others else _ANY_ORDER
    return changed


ALLOCATOR_VARIABLE: Final = "PLAY_LAUNCH_ALLOCATOR"
"""Environment variable that names the library to preload."""
WHEEL_LIBRARY: Final = Path("cmeel.prefix", "lib", "libmimalloc.so.3")
"""Where cmeel-mimalloc has it, below a folder of Python packages."""
_LIBRARIES: Final = ("mimalloc", "jemalloc")
"""Of the system, best first."""
FIX: Final = (
    "pip install cmeel-mimalloc (needs no setting), or install your distribution's mimalloc, or "
    f"set {ALLOCATOR_VARIABLE}=/path/to/libmimalloc.so"
)
"""Fix for a machine without one."""
ADVICE: Final = (
    "isolated containers run with glibc's malloc, whose locks a crashing node can leave locked: "
    "its container may then freeze, and is killed and started again with all of its nodes. "
    f"Fix: {FIX}"
)
TUNABLES_VARIABLE: Final = "GLIBC_TUNABLES"
"""Settings of glibc, `name=value` with colons between them."""
_ARENAS: Final = 100_000
"""More than a container has threads in its life."""
_HUGE_PAGES: Final = "MIMALLOC_ALLOW_THP"
"""Where mimalloc may use transparent huge pages. Most threads of a container touch a few of theirs,
and the kernel clears all 2 MB: half of a container's CPU time at its start, and 20 MB."""
_NAME: Final = re.compile(r"lib(?:mimalloc|jemalloc)\b.*\.so\b")


@dataclass(frozen=True, slots=True)
class Allocator:
    """What was found.

    Attributes:
        library: What to preload; None when there is nothing of use.
        problem: Why not, in words for people; empty when all is well.
    """

    library: Path | None
    problem: str = ""


def find_allocator(environ: Mapping[str, str] | None = None) -> Allocator:
    """Find the allocator that isolated containers preload; may run ldconfig.

    The processes of such a container share one heap. A process that dies inside of glibc's malloc
    may leave an arena locked, and threads that use that arena next wait without end. mimalloc and
    jemalloc give each thread a heap of its own.

    Args:
        environ: The environment; None for our own.
    """
    named = (os.environ if environ is None else environ).get(ALLOCATOR_VARIABLE, "")
    if named:
        if _is_library(Path(named)):
            return Allocator(Path(named))
        problem = f"{ALLOCATOR_VARIABLE} names {named}, which is no library"
        return Allocator(None, f"{problem}; {ADVICE}")
    for folder in map(Path, filter(None, sys.path)):
        if _is_library(folder / WHEEL_LIBRARY):
            return Allocator(folder / WHEEL_LIBRARY)
    from ctypes.util import find_library  # noqa: PLC0415 - all of the start waits for imports

    for name in _LIBRARIES:
        # A name without a slash is searched for by the dynamic linker.
        if library := find_library(name):
            return Allocator(Path(library))
    return Allocator(None, f"neither mimalloc nor jemalloc is installed; {ADVICE}")


def for_isolation(environment: Mapping[str, str], library: Path | None) -> dict[str, str]:
    """Return the environment of an isolated container: with the library, or the best without."""
    return (
        with_own_arenas(environment) if library is None else allocating_with(environment, library)
    )


def allocating_with(environment: Mapping[str, str], library: Path) -> dict[str, str]:
    """Add the library to what is preloaded, unless such an allocator is preloaded already.

    It then does without huge pages, unless the environment says otherwise.
    """
    if any(_NAME.match(Path(name).name) for name in preloaded_in(environment)):
        return dict(environment)
    changed = preloading(environment, library)
    if library.name.startswith("libmimalloc"):
        changed.setdefault(_HUGE_PAGES, "0")
    return changed


def with_own_arenas(environment: Mapping[str, str]) -> dict[str, str]:
    """Let each thread of the C library's allocator have an arena of its own.

    An arena has a lock, and one that a node held when it exited stays locked. By default there are
    eight per processor, shared by all threads. What the user set stays as it is.
    """
    changed = dict(environment)
    tunables = changed.get(TUNABLES_VARIABLE, "")
    if "glibc.malloc.arena_max=" not in tunables:
        ours = f"glibc.malloc.arena_max={_ARENAS}"
        changed[TUNABLES_VARIABLE] = f"{tunables}:{ours}" if tunables else ours
    return changed


def _is_library(file: Path) -> bool:
    try:
        with file.open("rb") as opened:
            return opened.read(4) == b"\x7fELF"
    except OSError:
        return False
