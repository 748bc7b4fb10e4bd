"""Whether a process uses Fast DDS, and whether its user has configured that by a profile.

Fast DDS 2.14 documents where it searches profiles ("XML profiles: loading and applying profiles").
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

IMPLEMENTATION: Final = "rmw_fastrtps_cpp"
"""What ROS 2 Jazzy uses when RMW_IMPLEMENTATION is not set."""
_PREFIX: Final = "rmw_fastrtps_"

PROFILE_VARIABLES: Final = (
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
)
"""The second one is read by Fast DDS 2, the RMW of ROS 2 Jazzy, the first one by later versions."""
PROFILE_FILES: Final = ("DEFAULT_FASTDDS_PROFILES.xml", "DEFAULT_FASTRTPS_PROFILES.xml")
"""Fast DDS reads these from the working directory, unless it is set to skip them."""
_SKIP_PROFILE_FILES: Final = "SKIP_DEFAULT_XML_FILE"


def is_fastdds(rmw: str) -> bool:
    """Whether a middleware, given by its identifier, is Fast DDS."""
    return rmw.startswith(_PREFIX)


def asks_for_fastdds(environment: Mapping[str, str]) -> bool:
    """Whether a process with this environment uses Fast DDS, by choice or by default."""
    return is_fastdds(environment.get("RMW_IMPLEMENTATION") or IMPLEMENTATION)


def files_here() -> list[str]:
    """Names of the files in the working directory; none where it cannot be read."""
    try:
        return [path.name for path in Path().iterdir()]
    except OSError:
        return []


def profile_in_use(environment: Mapping[str, str], files: Iterable[str]) -> str | None:
    """Describe where Fast DDS finds profiles, by the names in the working directory, too."""
    for variable in PROFILE_VARIABLES:
        if environment.get(variable):
            return f"{variable} is set"
    if environment.get(_SKIP_PROFILE_FILES) != "1":
        for name in sorted(set(files) & set(PROFILE_FILES)):
            return f"{name} is in the working directory"
    return None
