"""What can be done to a row by a key: which operation that is, and what is asked before it."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.cli.top.cells import clean
from play_launch.cli.top.rows import COMPONENT, Row, Subject

if TYPE_CHECKING:
    from collections.abc import Mapping


class Wish(Enum):
    """What a key stands for, whatever the row is; the value is the key."""

    AGAIN = "r"
    HALT = "x"
    GO = "s"


_FOR_MEMBERS: Final = {Wish.AGAIN: "restart", Wish.HALT: "stop", Wish.GO: "start"}
_FOR_NODES: Final = {Wish.AGAIN: "reload", Wish.HALT: "unload", Wish.GO: "load"}
DONE: Final = {
    "restart": "restarted",
    "stop": "stopped",
    "start": "started",
    "reload": "reloaded",
    "unload": "unloaded",
    "load": "loaded",
}

_POINTLESS: Final[Mapping[str, frozenset[str]]] = {
    "start": frozenset({"starting", "running", "pending", "waiting", "stopping", "killing"}),
    "stop": frozenset({"stopped", "stopping", "exited", "gave up"}),
    "restart": frozenset({"stopping", "killing", "pending", "waiting"}),
    "load": frozenset({"requested", "loading", "loaded", "unloading"}),
    "unload": frozenset({"unloaded", "unloading"}),
    "reload": frozenset({"pending", "unloading"}),
}
"""States in which an operation would change nothing. In others, the session judges."""
_AT_REST: Final = frozenset({"stopped", "gave up"})
"""A container that is in such a state loads nothing."""


class Proposal(Struct, frozen=True):
    """An operation that only needs a yes."""

    operation: str
    subject: Subject
    question: str


class Refusal(Struct, frozen=True):
    """Why a key does nothing."""

    reason: str


def operation_of(wish: Wish, row: Row) -> str:
    """Name the operation that a key means for a row."""
    return (_FOR_NODES if row.kind == COMPONENT else _FOR_MEMBERS)[wish]


def proposal(wish: Wish, row: Row, rows: Mapping[Subject, Row]) -> Proposal | Refusal:
    """Say what a key would do to a row.

    Args:
        wish: The key.
        row: The selected row.
        rows: All of them, shown or not.
    """
    operation, name = operation_of(wish, row), clean(row.name)
    if row.state in _POINTLESS[operation]:
        return Refusal(f"{name} is {row.state}: nothing to {operation}")
    if row.kind == COMPONENT:
        container = rows.get(Subject(None, row.container or ""))
        if operation != "unload" and container is not None and container.state in _AT_REST:
            of = clean(container.name)
            return Refusal(
                f"{of} is {container.state}, so {name} cannot be loaded: start {of} first"
            )
    return Proposal(operation, row.subject, f"{operation} {name}?{_impact(operation, row, rows)}")


def offered(row: Row | None, rows: Mapping[Subject, Row]) -> list[tuple[str, str]]:
    """List the keys that do something to a row, each with its operation."""
    if row is None:
        return []
    proposals = {wish: proposal(wish, row, rows) for wish in Wish}
    return [
        (wish.value, each.operation)
        for wish, each in proposals.items()
        if isinstance(each, Proposal)
    ]


def _impact(operation: str, row: Row, rows: Mapping[Subject, Row]) -> str:
    """Say what else it does: what runs in a container goes with it."""
    if operation not in {"stop", "restart"}:
        return ""
    loaded = [
        each for each in rows.values() if each.container == row.name and each.state == "loaded"
    ]
    if not loaded:
        return ""
    one = len(loaded) == 1
    if operation == "restart":
        return (
            " Its node is loaded again." if one else f" Its {len(loaded)} nodes are loaded again."
        )
    return " Its node goes with it." if one else f" Its {len(loaded)} nodes go with it."
