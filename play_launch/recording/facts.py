"""What a recording says about the machine and the environment it was made in."""

from __future__ import annotations

import os
import platform
import re
import sys
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

REDACTED: Final = "(redacted)"

_PACKAGES: Final = ("play-launch-py", "ros-rclpy", "rclpy", "mcap", "zstandard", "pydantic")

_KEPT_NAMES: Final = frozenset(
    {
        "COLUMNS",
        "DISPLAY",
        "HOME",
        "LANG",
        "LD_LIBRARY_PATH",
        "LD_PRELOAD",
        "LINES",
        "LOGNAME",
        "NO_COLOR",
        "PATH",
        "PWD",
        "SHELL",
        "TERM",
        "TZ",
        "USER",
        "VIRTUAL_ENV",
        "WAYLAND_DISPLAY",
        "XDG_RUNTIME_DIR",
        "XDG_SESSION_TYPE",
    }
)
_KEPT_PREFIXES: Final = (
    "AMENT_",
    "CMAKE_PREFIX_PATH",
    "COLCON_",
    "CUDA_",
    "CYCLONEDDS_",
    "FASTDDS_",
    "FASTRTPS_",
    "GZ_",
    "LC_",
    "OMP_",
    "PLAY_LAUNCH_",
    "PYTHON",
    "RCL_",
    "RCUTILS_",
    "RMW_",
    "ROS_",
    "SKIP_DEFAULT_XML",
    "ZENOH_",
)
_SECRET: Final = re.compile(
    r"secret|token|passw|passphrase|credential|private|cookie|(?:^|_)(?:api_?)?key(?:$|_)",
    re.IGNORECASE,
)
_URL_USER: Final = re.compile(r"(?<=://)[^/@\s]+(?=@)")


def redacted_environment(environ: Mapping[str, str]) -> dict[str, str]:
    """The environment, sorted by name, without values that may be secret.

    Every name is kept. A value is kept when its name is known to matter to ROS, to the dynamic
    linker, to Python or to the terminal and does not sound like a secret; user names and
    passwords in URLs are taken out of those as well.
    """
    return {
        name: _URL_USER.sub(REDACTED, value) if _kept(name) else REDACTED
        for name, value in sorted(environ.items())
    }


def _kept(name: str) -> bool:
    known = name in _KEPT_NAMES or name.startswith(_KEPT_PREFIXES)
    return known and not _SECRET.search(name)


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
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def boot_id() -> str:
    """The kernel's identifier of this boot; empty where /proc does not tell."""
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
