"""The allocator that isolated containers run with.

The processes of such a container share one heap. A process that dies inside of glibc's malloc may
leave an arena locked, and whoever uses that arena next waits for ever. mimalloc and jemalloc give
each thread a heap of its own, so they are preloaded where they are to be found: mimalloc as the
Python package cmeel-mimalloc first, then what the distribution has.
"""

from __future__ import annotations

import os
import re
import shutil
import site
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.container.preload import preloaded_in, preloading

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

ALLOCATOR_VARIABLE: Final = "PLAY_LAUNCH_ALLOCATOR"
"""Environment variable that names the library to preload."""
WHEEL_LIBRARY: Final = Path("cmeel.prefix", "lib", "libmimalloc.so.3")
"""Where cmeel-mimalloc has it, below a folder of Python packages."""
LIBRARIES: Final = ("libmimalloc.so.2", "libmimalloc.so.3", "libjemalloc.so.2")
"""What is looked for in the system, best first: its mimalloc 3 may be a preliminary version."""
FIX: Final = (
    "pip install cmeel-mimalloc (found by itself), or install your distribution's mimalloc, or set "
    f"{ALLOCATOR_VARIABLE}=/path/to/libmimalloc.so"
)
"""What to do where there is none."""
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
_LDCONFIG_LIMIT: Final = 5.0
"""Seconds."""
_ELF_HEADER: Final = 20
"""Bytes up to the machine that the file is for."""


@dataclass(frozen=True, slots=True)
class Allocator:
    """What was found.

    Attributes:
        library: What to preload; None when there is nothing of use.
        problem: Why not, in words for people; empty when all is well.
    """

    library: Path | None
    problem: str = ""


def find_allocator(
    environ: Mapping[str, str] | None = None,
    *,
    listing: Callable[[], str] | None = None,
    folders: Iterable[Path] | None = None,
    packages: Iterable[Path] | None = None,
) -> Allocator:
    """Find the allocator; runs ldconfig and reads the beginnings of files.

    Args:
        environ: The environment; None for our own.
        listing: Gives what `ldconfig -p` prints; None for the real one.
        folders: Where else to look for the system's; None for the usual places.
        packages: The folders of Python packages; None for those of this interpreter.
    """
    environ = os.environ if environ is None else environ
    named = environ.get(ALLOCATOR_VARIABLE, "")
    if named:
        library = Path(named)
        if _is_ours(library):
            return Allocator(library)
        problem = f"{ALLOCATOR_VARIABLE} names {named}, which is no library for this machine"
        return Allocator(None, f"{problem}; {ADVICE}")
    for folder in _package_folders() if packages is None else packages:
        if _is_ours(folder / WHEEL_LIBRARY):
            return Allocator(folder / WHEEL_LIBRARY)
    listed = (listing or _ldconfig)()
    folders = tuple(_usual_folders() if folders is None else folders)
    for name in LIBRARIES:
        for library in (*_listed(listed, name), *(folder / name for folder in folders)):
            if _is_ours(library):
                return Allocator(library)
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

    An arena has a lock, and one that is held by a dead node is held for ever. By default there are
    eight per processor, shared by all threads. What the user set stays as it is.
    """
    changed = dict(environment)
    tunables = changed.get(TUNABLES_VARIABLE, "")
    if "glibc.malloc.arena_max=" not in tunables:
        ours = f"glibc.malloc.arena_max={_ARENAS}"
        changed[TUNABLES_VARIABLE] = f"{tunables}:{ours}" if tunables else ours
    return changed


def _listed(listing: str, name: str) -> Iterator[Path]:
    for line in listing.splitlines():
        entry, arrow, path = line.partition(" => ")
        if arrow and entry.split()[:1] == [name]:
            yield Path(path.strip())


def _ldconfig() -> str:
    # Not in everybody's PATH.
    path = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/sbin"])
    program = shutil.which("ldconfig", path=path)
    if program is None:
        return ""
    try:
        result = subprocess.run(
            [program, "-p"], check=False, capture_output=True, timeout=_LDCONFIG_LIMIT
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return os.fsdecode(result.stdout)


def _package_folders() -> list[Path]:
    own = site.getusersitepackages() if site.ENABLE_USER_SITE else None
    return [Path(folder) for folder in (*site.getsitepackages(), own) if folder]


def _usual_folders() -> list[Path]:
    architecture = sysconfig.get_config_var("MULTIARCH") or ""
    return [
        Path(sys.prefix) / "lib",
        *(Path(root) / "lib" / architecture for root in ("/usr", "/") if architecture),
        Path("/usr/lib64"),
        Path("/usr/lib"),
        Path("/usr/local/lib"),
    ]


def _is_ours(library: Path) -> bool:
    """Whether it is a library for the machine that this Python is for."""
    try:
        return _machine(library) == _machine(Path(sys.executable))
    except (OSError, ValueError):
        return False


def _machine(file: Path) -> tuple[bytes, bytes]:
    with file.open("rb") as opened:
        header = opened.read(_ELF_HEADER)
    if len(header) < _ELF_HEADER or not header.startswith(b"\x7fELF"):
        msg = f"{file} is no ELF file"
        raise ValueError(msg)
    return header[4:6], header[18:20]
