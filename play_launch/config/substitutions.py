"""Substitutions in a text, and the arguments, variables and packages that they take.

`${env:NAME}`, `${arg:NAME:-default}` and `$(find-pkg-share package)`. `$${` and `$$(` stand for
`${` and `$(`. What looks like neither is text: a shell's `${HOME}` and `$(date)` reach the shell.
What can only be a slip or another program's substitution is refused.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct, field

from play_launch import UserError
from play_launch.config.model import TakenValues
from play_launch.config.problems import KNOWN, excerpt

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

DEEPEST_DEFAULT: Final = 10
"""Substitutions inside the default of one another."""
_BEGIN: Final = re.compile(
    r"\$\$(?=[{(])|\$\{(?P<kind>[a-z]+):(?=[A-Za-z_])|\$\((?P<word>[a-z_-]+)(?P<space>\s+|(?=\)))"
)
_BRACE: Final = re.compile(r"[{}]")
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
_PACKAGE: Final = re.compile(r"([A-Za-z][A-Za-z0-9_-]*)\s*\)", re.ASCII)
_SHARE: Final = "find-pkg-share"
_OF_LAUNCH_FILES: Final = {
    "var": "${arg:NAME}",
    "arg": "${arg:NAME}",
    "optenv": "${env:NAME:-default}",
    "find-pkg-prefix": "$(find-pkg-share package), and the way from there",
}
"""Substitutions of launch files that no shell has, and what is written here instead."""


def ament_prefixes(environ: Mapping[str, str]) -> list[Path]:
    return [
        Path(entry) for entry in environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry
    ]


def package_prefix(package: str, prefixes: Iterable[Path]) -> Path | None:
    """Find the first prefix where the package is installed, as ROS does."""
    marker = Path("share/ament_index/resource_index/packages", package)
    return next((prefix for prefix in prefixes if (prefix / marker).is_file()), None)


def share_folder(package: str, environ: Mapping[str, str] = os.environ) -> Path | None:
    """Find the share folder of a package; our own prefix first."""
    prefix = package_prefix(package, (Path(sys.prefix), *ament_prefixes(environ)))
    return prefix and prefix / "share" / package


def not_installed(package: str) -> str:
    return (
        f"package {package} is not installed: no prefix in AMENT_PREFIX_PATH has it; "
        "install it, or source its workspace"
    )


class Inputs(Struct, frozen=True):
    """Arguments of the command line, the environment, and where packages are."""

    arguments: Mapping[str, str] = field(default_factory=dict)
    environ: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    find_share: Callable[[str], Path | None] = share_folder


class InputsUsed:
    """Looks inputs up for one configuration, and keeps which were used."""

    def __init__(self, inputs: Inputs) -> None:
        self._inputs = inputs
        self._variables: dict[str, str | None] = {}
        self._packages: dict[str, str] = {}
        self.arguments = dict(inputs.arguments)
        """The arguments of the command line."""
        self.known_arguments: set[str] = set()
        """The arguments that the files read, given or not."""

    def values(self) -> TakenValues:
        return TakenValues(self.arguments, self._variables, self._packages)

    def substitutions(self, arguments: Mapping[str, str]) -> Callable[[str], str]:

        def argument(name: str) -> str | None:
            self.known_arguments.add(name)
            return arguments.get(name)

        lookup = Lookup(self._variable, argument, self._share)
        return lambda text: substitute(text, lookup)

    def _variable(self, name: str) -> str | None:
        self._variables[name] = value = self._inputs.environ.get(name)
        return value

    def _share(self, package: str) -> str:
        if package not in self._packages:
            folder = self._inputs.find_share(package)
            if folder is None:
                raise PackageMissingError(not_installed(package))
            self._packages[package] = str(folder)
        return self._packages[package]


class ArgumentError(UserError, ValueError):
    """An argument of the configuration with a mistake; the text has the fix."""


def parse_arguments(texts: Sequence[str]) -> dict[str, str]:
    """Read `name:=value` from a command line; raises ArgumentError."""
    arguments: dict[str, str] = {}
    for text in texts:
        name, assigned, value = text.partition(":=")
        if not name or not assigned:
            raise ArgumentError(f"'{text}' is not an argument; write name:=value")
        if name in arguments:
            raise ArgumentError(f"the argument {name} is given twice")
        arguments[name] = value
    return arguments


class SubstitutionError(ValueError):
    """A substitution with a mistake, or without a value; the text is the fix."""


class PackageMissingError(SubstitutionError):
    """A package that is not installed here; it may be on another machine."""


class Lookup(Struct, frozen=True):
    """Sources of values: each function returns the value of a name, None without one."""

    variable: Callable[[str], str | None]
    argument: Callable[[str], str | None]
    share: Callable[[str], str]
    """The share folder of a package; raises SubstitutionError."""


def may_hold_substitutions(text: str) -> bool:
    """Return whether `substitute` could change the text, or refuse it; quick."""
    return "$" in text and ("${" in text or "$(" in text)


def substitute(text: str, lookup: Lookup) -> str:
    """Return `text` with its substitutions carried out; raise SubstitutionError.

    A value is not substituted again: a `$` in it is a `$`.
    """
    return _read(text, 0, lookup, depth=0, needed=True)[0]


def _read(text: str, at: int, lookup: Lookup, *, depth: int, needed: bool) -> tuple[str, int]:
    """Read from `at` to the end, or below a default to its `}`; braces in a default are paired.

    What is not needed may have no value.
    """
    done: list[str] = []
    opened = 0
    while True:
        found = _BEGIN.search(text, at)
        brace = _BRACE.search(text, at) if depth else None
        if brace is not None and (found is None or brace.start() < found.start()):
            done.append(text[at : brace.start()])
            opened += 1 if brace[0] == "{" else -1
            if opened < 0:
                return "".join(done), brace.start()
            done.append(brace[0])
            at = brace.end()
            continue
        if found is None:
            if depth:
                raise SubstitutionError(f"{excerpt(text)}: a substitution is not closed by }}")
            done.append(text[at:])
            return "".join(done), len(text)
        done.append(text[at : found.start()])
        if found["kind"] is not None:
            value, at = _braces(text, found, lookup, depth, needed)
        elif found["word"] is not None:
            value, at = _parentheses(text, found, lookup, needed)
        else:
            value, at = text[found.end() - 1 : found.end() + 1], found.end() + 1
        done.append(value)


def _braces(
    text: str, found: re.Match[str], lookup: Lookup, depth: int, needed: bool
) -> tuple[str, int]:
    kind = found["kind"]
    if kind not in {"env", "arg"}:
        raise SubstitutionError(
            f"{excerpt(text[found.start() : found.end()] + '…}')} is no substitution{KNOWN}"
            "${env:NAME} and ${arg:NAME}; write $${ for the characters ${ themselves"
        )
    matched = _NAME.match(text, found.end())
    assert matched is not None
    name, after = matched[0], matched.end()
    value = lookup.variable(name) if kind == "env" else lookup.argument(name)
    if text.startswith("}", after):
        if value is None and needed:
            missing = (
                f"the environment variable {name} is not set; set it"
                if kind == "env"
                else f"the argument {name} is not given; append {name}:=value to the command"
            )
            fix = f"or write a default: ${{{kind}:{name}:-default}}"
            raise SubstitutionError(f"{missing}, {fix}")
        return value or "", after + 1
    if not text.startswith(":-", after):
        raise SubstitutionError(
            f"{excerpt(text[found.start() :])}: after the name of a substitution stands }} or "
            ":-default}"
        )
    if depth >= DEEPEST_DEFAULT:
        raise SubstitutionError(f"defaults in one another deeper than {DEEPEST_DEFAULT} levels")
    default, close = _read(text, after + 2, lookup, depth=depth + 1, needed=needed and not value)
    return value or default, close + 1


def _parentheses(text: str, found: re.Match[str], lookup: Lookup, needed: bool) -> tuple[str, int]:
    word = found["word"]
    if word != _SHARE:
        if word in _OF_LAUNCH_FILES and found["space"]:
            raise SubstitutionError(
                f"$({word} …) is for launch files; write {_OF_LAUNCH_FILES[word]} here, or $$( for "
                "the characters $( themselves"
            )
        if word.startswith("find") and "pkg" in word and found["space"]:
            raise SubstitutionError(f"$({word} …) is no substitution; write $({_SHARE} package)")
        # A command for a shell.
        return text[found.start() : found.end()], found.end()
    package = _PACKAGE.match(text, found.end())
    if package is None:
        raise SubstitutionError(f"expected $({_SHARE} package), given {excerpt(text)}")
    return lookup.share(package[1]) if needed else "", package.end()
