"""Whether Fast DDS is configured by a profile of the user, which is then left alone.

Where its profiles are looked for is documented by Fast DDS 2.14 ("XML profiles: loading and
applying profiles").
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

PROFILE_VARIABLES: Final = (
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
)
"""The second one is read by Fast DDS 2, the RMW of ROS 2 Jazzy."""
PROFILE_FILES: Final = ("DEFAULT_FASTDDS_PROFILES.xml", "DEFAULT_FASTRTPS_PROFILES.xml")
"""Fast DDS reads these from the working directory, unless it is set to skip them."""
_SKIP_PROFILE_FILES: Final = "SKIP_DEFAULT_XML_FILE"


def files_here() -> list[str]:
    """Names of the files in the working directory; none where it cannot be read."""
    try:
        return [path.name for path in Path().iterdir()]
    except OSError:
        return []


def profile_in_use(environment: Mapping[str, str], files: Iterable[str]) -> str | None:
    """Say where Fast DDS finds profiles, None where it finds none.

    Args:
        environment: That of the process.
        files: Names of the files in its working directory.
    """
    for variable in PROFILE_VARIABLES:
        if environment.get(variable):
            return f"{variable} is set"
    if environment.get(_SKIP_PROFILE_FILES) != "1":
        for name in sorted(set(files) & set(PROFILE_FILES)):
            return f"{name} is in the working directory"
    return None
