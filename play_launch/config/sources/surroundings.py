"""What a configuration takes from outside of its files, and what it took."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct, field

from play_launch.config.ament_index import ament_prefixes
from play_launch.config.sources.substitution import Lookup, SubstitutionError, substitute

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from play_launch.config.yaml.tree import At

MOST_SUBSTITUTED: Final = 4 * 1024 * 1024
"""Characters that substitutions put into one configuration."""
_ARGUMENT: Final = re.compile(r"([A-Za-z_][A-Za-z0-9_]*):=(.*)", re.ASCII | re.DOTALL)


def share_folder(package: str, environ: Mapping[str, str] = os.environ) -> Path | None:
    """Find the share folder of a package as ROS does; our own prefix first."""
    for prefix in (Path(sys.prefix), *ament_prefixes(environ)):
        if (prefix / "share/ament_index/resource_index/packages" / package).is_file():
            return prefix / "share" / package
    return None


class Surroundings(Struct, frozen=True):
    """Arguments of the command line, the environment, and where packages are."""

    arguments: Mapping[str, str] = field(default_factory=dict)
    environ: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    find_share: Callable[[str], Path | None] = share_folder


class Given(Struct):
    """An argument of an inclusion or of the command line, where `at` is None."""

    value: str
    at: At | None = None
    is_read: bool = False


class Taken:
    """Gives values of the surroundings, and keeps which were asked for; one for each reading."""

    def __init__(self, surroundings: Surroundings) -> None:
        self._from = surroundings
        self._left = MOST_SUBSTITUTED
        self._packages: dict[str, str] = {}
        self.variables: dict[str, str | None] = {}
        """The variables that were asked for, and their values; None: not set."""
        self.known_arguments: set[str] = set()
        """The arguments that the files read, given or not."""

    @property
    def arguments(self) -> dict[str, str]:
        """The arguments that were given."""
        return dict(self._from.arguments)

    @property
    def is_touched(self) -> bool:
        """Whether anything was given or taken."""
        return bool(self._from.arguments or self.variables or self._packages)

    @property
    def packages(self) -> dict[str, str]:
        """The packages whose share folder was taken, and the folders."""
        return dict(self._packages)

    def substitutions(self, own: Mapping[str, Given]) -> Callable[[str], str]:
        """Return what carries out substitutions in a file that is included with arguments."""

        def argument(name: str) -> str | None:
            self.known_arguments.add(name)
            given = own.get(name)
            if given is None:
                return None
            given.is_read = True
            return given.value

        lookup = Lookup(self._variable, argument, self._share)

        def carry_out(text: str) -> str:
            result = substitute(text, lookup)
            self._left -= len(result)
            if self._left < 0:
                mebibytes = MOST_SUBSTITUTED // 2**20
                raise SubstitutionError(
                    f"substitutions put more than {mebibytes} Mi characters into the configuration"
                )
            return result

        return carry_out

    def _variable(self, name: str) -> str | None:
        self.variables[name] = value = self._from.environ.get(name)
        return value

    def _share(self, package: str) -> str:
        if package not in self._packages:
            folder = self._from.find_share(package)
            if folder is None:
                raise SubstitutionError(
                    f"no package {package} is installed: none of the prefixes in "
                    f"AMENT_PREFIX_PATH has it, nor has {sys.prefix}; source its workspace"
                )
            self._packages[package] = str(folder)
        return self._packages[package]


def parse_arguments(texts: Sequence[str]) -> dict[str, str]:
    """Read `name:=value` from a command line; raise ValueError with the fix."""
    arguments: dict[str, str] = {}
    for text in texts:
        found = _ARGUMENT.fullmatch(text)
        if found is None:
            raise ValueError(f"'{text}' is not an argument; write name:=value")
        if found[1] in arguments:
            raise ValueError(f"the argument {found[1]} is given twice")
        arguments[found[1]] = found[2]
    return arguments
