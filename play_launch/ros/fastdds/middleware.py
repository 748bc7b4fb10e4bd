"""Whether a process uses Fast DDS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

IMPLEMENTATION: Final = "rmw_fastrtps_cpp"
"""What ROS 2 Jazzy uses when RMW_IMPLEMENTATION is not set."""
_PREFIX: Final = "rmw_fastrtps_"


def is_fastdds(rmw: str) -> bool:
    """Whether a middleware, given by its identifier, is Fast DDS."""
    return rmw.startswith(_PREFIX)


def asks_for_fastdds(environment: Mapping[str, str]) -> bool:
    """Whether a process with this environment uses Fast DDS, by choice or by default."""
    return is_fastdds(environment.get("RMW_IMPLEMENTATION") or IMPLEMENTATION)
