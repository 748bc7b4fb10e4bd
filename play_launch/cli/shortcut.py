"""Reads plain command lines of ``replay`` and ``check`` without typer.

Importing typer takes as long as a container takes to start, or longer than a small configuration
takes to check. Whatever is not plain (help, mistakes, ``--option=value``) is left to typer, which
then says the same as ever.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

_OPTIONS: Mapping[str, Mapping[str, tuple[str, Callable[[str], Any] | None]]] = {
    "replay": {
        "--log-dir": ("log_dir", Path),
        "--duration": ("duration", str),
        "--quiet": ("quiet", None),
        "-q": ("quiet", None),
        "--json": ("as_json", None),
        "--watch": ("watch", None),
    },
    "check": {"--json": ("as_json", None), "--explain": ("explain", None)},
}
"""The parameter of each option, and how its value is read; None where it has no value."""


def plain_parameters(verb: str, arguments: Sequence[str]) -> dict[str, Any] | None:
    """Return the parameters of ``verb`` as given, without defaults; None: ask typer."""
    options = _OPTIONS.get(verb)
    if options is None:
        return None
    found: dict[str, Any] = {}
    rest = iter(arguments)
    for argument in rest:
        if not argument.startswith("-"):
            if not argument:
                return None
            if "config" in found:
                found.setdefault("arguments", []).append(argument)
            else:
                found["config"] = Path(argument)
            continue
        name, read = options.get(argument, ("", None))
        if not name:
            return None
        value = next(rest, "-") if read else ""
        if value.startswith("-"):
            return None
        found[name] = read(value) if read else True
    return found if "config" in found else None


def run_plainly(arguments: Sequence[str]) -> int | None:
    """Carry out a plain ``replay`` or ``check`` and return its exit code; None: ask typer."""
    if not arguments:
        return None
    parameters = plain_parameters(arguments[0], arguments[1:])
    if parameters is None:
        return None
    if arguments[0] == "check":
        from play_launch.cli.find_mistakes import find_mistakes  # noqa: PLC0415

        return find_mistakes(**parameters)
    from play_launch.actors import head_start  # noqa: PLC0415 - before all that takes its time
    from play_launch.systemd.notification import claim  # noqa: PLC0415 - as above

    # Whatever is started from here on has no business with it.
    manager = claim(os.environ)
    head_start.begin(parameters["config"])
    from play_launch.cli.bring_up import bring_up  # noqa: PLC0415

    return bring_up(**parameters, manager=manager)
