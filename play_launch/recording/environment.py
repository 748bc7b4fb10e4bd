"""What a recording says about the machine and the environment it was made in."""

from __future__ import annotations

import os
import platform
import re
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

REDACTED: Final = "(redacted)"

OURSELVES: Final = "play-launch-py"
_PACKAGES: Final = (
    OURSELVES,
    "play-launch-container",
    "ros-rclpy",
    "rclpy",
    "mcap",
    "zstandard",
    "pydantic-core",
)

_DESCRIPTION: Final = re.compile(r"(.+?)-(\d[^-]*)(?:-.*)?\.(?:dist|egg)-info")
_SEPARATORS: Final = re.compile(r"[-_.]+")

_KEPT: Final = re.compile(
    "COLUMNS|DISPLAY|HOME|LANG|LD_LIBRARY_PATH|LD_PRELOAD|LINES|LOGNAME|NO_COLOR|PATH|PWD|SHELL|TERM"
    "|TZ|USER|VIRTUAL_ENV|WAYLAND_DISPLAY|XDG_RUNTIME_DIR|XDG_SESSION_TYPE"
)
_KEPT_UNLESS_SECRET: Final = re.compile(
    "(AMENT_|CMAKE_PREFIX_PATH|COLCON_|CUDA_|CYCLONEDDS_|FASTDDS_|FASTRTPS_|GZ_|LC_|OMP_|PLAY_LAUNCH_"
    "|PYTHON|RCL_|RCUTILS_|RMW_|ROS_|SKIP_DEFAULT_XML|ZENOH_(?!CONFIG_OVERRIDE$)).*"
)
"""One of Zenoh's holds a configuration of any content instead of naming its file."""
_SECRET: Final = re.compile(
    r"secret|token|passw|passphrase|credential|private|cookie|keyring|bearer"
    r"|(?:^|_)(?:(?:api|access|auth|signing)_?)?key(?:$|_)"
    r"|(?:^|_)(?:pass|pwd|o?auth2?|authorization|pin|jwt|psk|otp)(?:$|_)",
    re.IGNORECASE,
)
_TOKEN: Final = re.compile(
    r"(?<=\bbearer )\S+|(?<=\bbasic )\S{8,}"
    r"|\beyJ[\w-]+\.[\w-]+\.[\w-]*|\bgh[opsur]_\w{20,}|-----BEGIN [^-]*PRIVATE KEY.*",
    re.IGNORECASE | re.DOTALL,
)
"""What is a secret by its form, under whatever name."""
_INLINE: Final = re.compile(r"<|^\s*\{\s*[\"']?\w+[\"']?\s*:")
"""In a value that should name a file: XML or JSON in its place."""
_URL_USER: Final = re.compile(r"(?<=://)[^/@\s]+(?=@)")
_URL_QUERY: Final = re.compile(r"(?<=[?#])[^\s,;]*=[^\s,;]*")
_ASSIGNED: Final = re.compile(
    r"((?:secret|token|passw(?:or)?d|passphrase|pwd|credentials?|api_?key)[\"']?\s*[=:]\s*)\S+",
    re.IGNORECASE,
)


def redacted_environment(environ: Mapping[str, str]) -> dict[str, str]:
    """The environment, sorted by name, without values that may be secret.

    Every name is kept. A value is kept when its name is known to matter to ROS, to the dynamic
    linker, to Python or to the terminal and does not sound like a secret, unless it is a
    configuration itself (inline XML or JSON). User names, passwords and queries in URLs, and
    what is assigned to a name like ``password``, are taken out of kept values as well.
    """
    return {
        name: _without_secrets(value) if _kept(name) else REDACTED
        for name, value in sorted(environ.items())
    }


def is_secret(name: str, value: str) -> bool:
    """Whether a value that a configuration asks for by its name stays out of the recording."""
    return _SECRET.search(name) is not None or _without_secrets(value) != value


def _kept(name: str) -> bool:
    if _KEPT.fullmatch(name):
        return True
    return bool(_KEPT_UNLESS_SECRET.fullmatch(name)) and not _SECRET.search(name)


def _without_secrets(value: str) -> str:
    if _INLINE.search(value):
        return REDACTED
    value = _URL_USER.sub(REDACTED, value)
    value = _URL_QUERY.sub(REDACTED, value)
    value = _TOKEN.sub(REDACTED, value)
    return _ASSIGNED.sub(rf"\1{REDACTED}", value)


def host_facts() -> dict[str, str | int]:
    """The machine: names and versions as text, sizes in bytes."""
    system = platform.uname()
    return {
        "host": system.node,
        "system": system.system,
        "kernel": system.release,
        "kernel_version": system.version,
        "machine": system.machine,
        "distribution": _distribution(),
        "boot_id": boot_id(),
        "cpus": os.cpu_count() or 0,
        "cpus_usable": len(os.sched_getaffinity(0)),
        "memory": os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"),
        "page_size": os.sysconf("SC_PAGE_SIZE"),
        "pid": os.getpid(),
        "uid": os.getuid(),
        "working_folder": _working_folder(),
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that take part; those not installed are left out."""
    found = {name: package_version(name) for name in _PACKAGES}
    return {"python": platform.python_version(), **{name: v for name, v in found.items() if v}}


def package_version(name: str) -> str:
    """Return the version of an installed package; empty where it is not installed."""
    return _installed(tuple(sys.path)).get(_SEPARATORS.sub("_", name).lower(), "")


@cache
def _installed(path: tuple[str, ...]) -> dict[str, str]:
    # `importlib.metadata` reads the descriptions as mail: 20 ms of a start in which everything
    # waits. The names of their folders have the version as well.
    found: dict[str, str] = {}
    for folder in path:
        try:
            names = os.listdir(folder or ".")  # noqa: PTH208 - a Path for each takes longer
        except OSError:  # a zip file, or nothing
            continue
        for match in filter(None, map(_DESCRIPTION.fullmatch, names)):
            found.setdefault(_SEPARATORS.sub("_", match[1]).lower(), match[2])
    return found


def boot_id() -> str:
    """The kernel's identifier of this boot; empty where /proc does not have it."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _distribution() -> str:
    try:
        return platform.freedesktop_os_release().get("PRETTY_NAME", "")
    except OSError:
        return sys.platform


def _working_folder() -> str:
    try:
        return str(Path.cwd())
    except FileNotFoundError:
        return ""
