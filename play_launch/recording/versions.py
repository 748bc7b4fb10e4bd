"""Versions of what is installed, by the names of the folders that describe it.

``importlib.metadata`` opens these and reads them as mail, which takes 20 ms of a start in which
everything waits. The names of the folders tell the same: ``<name>-<version>.dist-info`` (binary
distribution format of the Python packaging guide), and ``<name>-<version>-py3.12.egg-info`` where
ROS was built from source.
"""

from __future__ import annotations

import os
import re
import sys
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

OURSELVES: Final = "play-launch-py"
_FOLDER: Final = re.compile(r"(.+?)-(\d[^-]*)(?:-.*)?\.(?:dist|egg)-info")
_SEPARATORS: Final = re.compile(r"[-_.]+")


def installed_versions(
    packages: Collection[str], path: Sequence[str] | None = None
) -> dict[str, str]:
    """Find the versions of packages; those that are not installed are left out.

    Args:
        packages: Their names, in the order of the answer.
        path: Where to look, by default ``sys.path``; what is found first counts.
    """
    wanted = {_SEPARATORS.sub("_", name).lower(): name for name in packages}
    found: dict[str, str] = {}
    for folder in sys.path if path is None else path:
        try:
            names = os.listdir(folder or ".")  # noqa: PTH208 - a Path for each takes longer
        except OSError:  # a zip file, or nothing
            continue
        for entry in names:
            if entry.endswith("-info") and (match := _FOLDER.fullmatch(entry)):
                name = wanted.get(_SEPARATORS.sub("_", match[1]).lower())
                if name is not None:
                    found.setdefault(name, match[2])
    return {name: found[name] for name in packages if name in found}
