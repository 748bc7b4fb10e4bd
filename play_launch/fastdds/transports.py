"""Over which transports the graph daemon's own participant meets others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch.fastdds.middleware import is_fastdds
from play_launch.fastdds.profiles import profile_in_use

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

VARIABLE: Final = "FASTDDS_BUILTIN_TRANSPORTS"
_OURS: Final = "UDPv4"


@dataclass(frozen=True, slots=True)
class Transports:
    """What the daemon does about the transports of Fast DDS, and why."""

    variables: Mapping[str, str]
    """To be added to the environment of the daemon's process."""
    reason: str


def choose_transports(
    environment: Mapping[str, str], files: Iterable[str], rmw: str
) -> Transports | None:
    """Decide about the transports of Fast DDS in the daemon's own process.

    Shared-memory discovery stalls under load and on what crashed processes left in `/dev/shm`; UDP
    does not. A configuration made by the user is left alone.

    Args:
        environment: That of the daemon.
        files: Names of the files in its working directory.
        rmw: The middleware in use.

    Returns:
        None with another middleware, whose transports are its own business.
    """
    if not is_fastdds(rmw):
        return None
    if (
        environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST"
        or environment.get("ROS_LOCALHOST_ONLY") == "1"
    ):
        # It is not built in: rmw_fastrtps adds a shared-memory and a UDP transport of its own then.
        return Transports({}, "rmw_fastrtps chooses its own for LOCALHOST")
    if VARIABLE in environment:
        return Transports({}, f"{VARIABLE} is set")
    profile = profile_in_use(environment, files)
    if profile is not None:
        return Transports({}, profile)
    return Transports({VARIABLE: _OURS}, "no profile is set")
