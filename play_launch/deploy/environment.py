"""Which variables of the shell a service has to carry. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.deploy.quoting import is_acceptable
from play_launch.recording.facts import is_secret

if TYPE_CHECKING:
    from collections.abc import Mapping

_NAMES: Final = frozenset({"LD_LIBRARY_PATH", "PATH", "PYTHONPATH", "TZ"})
_PREFIXES: Final = (
    "AMENT_",
    "CUDA_",
    "CYCLONEDDS_",
    "FASTDDS_",
    "FASTRTPS_",
    "GZ_",
    "OMP_",
    "PLAY_LAUNCH_",
    "RCL_",
    "RCUTILS_",
    "RMW_",
    "ROS_",
    "SKIP_DEFAULT_XML",
    "ZENOH_",
)
"""Of ROS's setup files, the middlewares, and ours."""
_OF_XML: Final = frozenset({"CYCLONEDDS_URI"})
"""They may hold a configuration instead of naming its file, which is no secret by itself."""


class Carried(NamedTuple):
    """Variables by name."""

    values: Mapping[str, str]
    secrets: tuple[str, ...]
    """Names of those that everybody could read in a unit."""
    impossible: tuple[str, ...]
    """Names of those that systemd does not take."""


def carried(environ: Mapping[str, str], taken: Mapping[str, str | None]) -> Carried:
    """Choose what a sourced ROS, its middleware and the configuration need.

    Args:
        environ: That of the shell.
        taken: The variables that the configuration asks for, and their values; None: not set.
    """
    values: dict[str, str] = {}
    secrets, impossible = [], []
    for name, value in sorted(environ.items()):
        if name not in _NAMES and not name.startswith(_PREFIXES) and taken.get(name) is None:
            continue
        if not is_acceptable(f"{name}{value}"):
            impossible.append(name)
        elif is_secret(name, value.replace("<", " ") if name in _OF_XML else value):
            secrets.append(name)
        else:
            values[name] = value
    return Carried(values, tuple(secrets), tuple(impossible))
