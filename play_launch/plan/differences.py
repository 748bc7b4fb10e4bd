"""What differs between two descriptions of one thing, and what it takes to have it hold.

Descriptions are those of :mod:`play_launch.config.description`. What is not in a table needs what
is safe for its kind, so a new key of the configuration can be forgotten here without harm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.plan.steps import Change, Kind, Need

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

Described = dict[str, object]

_SAFE: Final = {
    Kind.SESSION: Need.NEXT_RUN,
    Kind.CONTAINER: Need.RESTART,
    Kind.COMPONENT: Need.RELOAD,
    Kind.PROCESS: Need.RESTART,
}
"""What a changed value needs unless it is in the table of its kind."""

_NEEDS: Final[Mapping[Kind, Mapping[str, Need]]] = {
    # What has to hold before a start is looked at when something is started.
    Kind.SESSION: dict.fromkeys(("stop", "start_rules", "managed"), Need.NOTHING),
    Kind.CONTAINER: dict.fromkeys(
        ("on_exit", "restart", "loading_timeout", "probe_timeout", "output"), Need.NOTHING
    ),
    Kind.COMPONENT: dict.fromkeys(("on_crash", "restart"), Need.NOTHING),
    Kind.PROCESS: dict.fromkeys(("on_exit", "restart", "output"), Need.NOTHING),
}

_NO_DIFFERENCE: Final = {
    # Those of members are in their own descriptions. Where a file is makes no difference, nor does
    # the session's name, which is that of its file unless it is given.
    Kind.SESSION: {
        "version",
        "name",
        "source",
        "included_files",
        "parameter_files",
        "taken",
        "environment",
        "containers",
        "nodes",
    },
    Kind.CONTAINER: {"line", "file", "composable_nodes"},
    Kind.COMPONENT: {"line", "file", "key", "full_name"},
    Kind.PROCESS: {"line", "file"},
}
"""Keys that are not looked at."""

_PARAMETERS: Final = "parameters"


def differences(kind: Kind, before: Described, after: Described) -> tuple[Change, ...]:
    """Compare two descriptions of the same member, node or session."""
    found: list[Change] = []
    for key in _keys(before, after):
        if key in _NO_DIFFERENCE[kind]:
            continue
        if key == _PARAMETERS:
            found += _parameters(kind, after, before.get(key), after.get(key))
        else:
            need = _NEEDS[kind].get(key, _SAFE[kind])
            found += _values(key, before.get(key), after.get(key), need)
    return tuple(found)


def _values(path: str, before: object, after: object, need: Need) -> Iterator[Change]:
    if isinstance(before, dict) and isinstance(after, dict):
        for key in _keys(before, after):
            yield from _values(f"{path}.{key}", before.get(key), after.get(key), need)
    elif before != after:
        yield Change(path, before, after, need)


def _parameters(kind: Kind, node: Described, before: object, after: object) -> Iterator[Change]:
    """Compare parameters.

    What a node was given cannot be taken back from it, and one whose name is not declared cannot
    be asked.
    """
    assert isinstance(before, dict)
    assert isinstance(after, dict)
    for name in _keys(before, after):
        was, is_ = before.get(name), after.get(name)
        if was != is_:
            settable = is_ is not None and bool(node.get("name"))
            yield Change(f"{_PARAMETERS}.{name}", was, is_, Need.SET if settable else _SAFE[kind])


def _keys(before: Mapping[str, object], after: Mapping[str, object]) -> list[str]:
    return list(dict.fromkeys((*before, *after)))
