"""Reads plain command lines of ``replay``, ``check``, ``launch`` and ``dump`` without typer.

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


def _containers(value: str) -> Any:
    from play_launch.launch_files.configuration.options import Containers  # noqa: PLC0415

    return Containers(value)


_OF_RUNS: Mapping[str, tuple[str, Callable[[str], Any] | None]] = {
    "--log-dir": ("log_dir", Path),
    "--duration": ("duration", str),
    "--quiet": ("quiet", None),
    "-q": ("quiet", None),
    "--json": ("as_json", None),
}
_OF_LAUNCH_FILES: Mapping[str, tuple[str, Callable[[str], Any] | None]] = {
    "--container-type": ("container_type", _containers),
    "--strict": ("strict", None),
    "--show-args": ("show_args", None),
    "-s": ("show_args", None),
    "--timeout": ("timeout", str),
    "--launch-prefix": ("launch_prefix", str),
    "--launch-prefix-filter": ("launch_prefix_filter", str),
    "--show-all-subprocesses-output": ("show_all", None),
    "-a": ("show_all", None),
    "--json": ("as_json", None),
}
_OPTIONS: Mapping[str, Mapping[str, tuple[str, Callable[[str], Any] | None]]] = {
    "replay": {**_OF_RUNS, "--watch": ("watch", None)},
    "check": {"--json": ("as_json", None), "--explain": ("explain", None)},
    "launch": {
        **_OF_RUNS,
        **_OF_LAUNCH_FILES,
        "--dry-run": ("dry_run", None),
        "-n": ("dry_run", None),
    },
    "dump": {
        **_OF_LAUNCH_FILES,
        "--output": ("output", Path),
        "-o": ("output", Path),
        "--inline": ("inline", None),
    },
}
"""The parameter of each option, and how its value is read; None where it has no value."""


def plain_parameters(verb: str, arguments: Sequence[str]) -> dict[str, Any] | None:
    """Return the parameters of ``verb`` as given, without defaults; None: ask typer."""
    options = _OPTIONS.get(verb)
    if options is None:
        return None
    found: dict[str, Any] = {}
    words: list[str] = []
    rest = iter(arguments)
    for argument in rest:
        if not argument.startswith("-"):
            if not argument:
                return None
            words.append(argument)
            continue
        name, read = options.get(argument, ("", None))
        if not name:
            return None
        value = next(rest, "-") if read else ""
        if value.startswith("-"):
            return None
        try:
            found[name] = read(value) if read else True
        except ValueError:
            return None
    if not words:
        return None
    if verb in {"launch", "dump"}:
        return {"target": words, **found}
    if words[1:]:
        found["arguments"] = words[1:]
    return {"config": Path(words[0]), **found}


def run_plainly(arguments: Sequence[str]) -> int | None:
    """Carry out a plain command line and return its exit code; None: ask typer."""
    if not arguments:
        return None
    parameters = plain_parameters(arguments[0], arguments[1:])
    if parameters is None:
        return None
    match arguments[0]:
        case "check":
            from play_launch.cli.check import find_mistakes  # noqa: PLC0415

            return find_mistakes(**parameters)
        case "dump":
            from play_launch.cli.dump import dump_launch_file  # noqa: PLC0415

            return dump_launch_file(**parameters)
        case "launch":
            from play_launch.cli.launch import bring_up_launch_file  # noqa: PLC0415

            return bring_up_launch_file(**parameters)
    from play_launch.deploy.notification import claim  # noqa: PLC0415 - as above
    from play_launch.runtime import prestart as head_start  # noqa: PLC0415

    # Whatever is started from here on has no business with it.
    manager = claim(os.environ)
    head_start.begin(parameters["config"])
    from play_launch.cli.replay import bring_up  # noqa: PLC0415

    return bring_up(**parameters, manager=manager)
