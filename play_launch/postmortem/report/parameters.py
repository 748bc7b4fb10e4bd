"""The parameters of nodes, as a page shows them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.postmortem.parameters import shortened
from play_launch.postmortem.report.page import shown

if TYPE_CHECKING:
    from play_launch.postmortem.parameters import KnownParameters, Parameters

_MOST: Final = 20_000
"""Parameters and changes of all nodes together; a page of 110 nodes has about 2,000."""


class ParameterChanged(Struct, frozen=True):
    """A change; times are milliseconds since the start."""

    at: float
    name: str
    before: str
    after: str


class NodeParameters(Struct, frozen=True):
    """Those of one node at the end of the session."""

    node: str
    note: str
    """What to know about them; empty: they are what it answered, and what changed since."""
    values: tuple[tuple[str, str], ...]
    changes: tuple[ParameterChanged, ...]


def parameters_shown(parameters: Parameters, started_ns: int) -> tuple[NodeParameters, ...]:
    """Give what a page shows, by node."""
    left = _MOST
    found = []
    for name, known in sorted(parameters.nodes.items()):
        each = _of_node(name, known, started_ns, left)
        left -= len(each.values) + len(each.changes)
        found.append(each)
    return tuple(found)


def _of_node(name: str, known: KnownParameters, started_ns: int, most: int) -> NodeParameters:
    values = sorted(known.values.items())
    notes = []
    if known.error:
        notes.append(f"When it was asked last: {known.error}.")
    if not known.asked_ns:
        notes.append("Only what changed is known.")
    left_out = len(values) - min(len(values), most)
    changes = known.changes[: max(0, most - len(values))]
    left_out += len(known.changes) - len(changes) + known.further_changes
    if left_out:
        notes.append(f"Left out, as a page cannot hold as many: {left_out:,}.")
    return NodeParameters(
        shown(name),
        shown(" ".join(notes)),
        tuple((shown(one), shown(shortened(value))) for one, value in values[:most]),
        tuple(
            ParameterChanged(
                (each.at_ns - started_ns) / 1e6,
                shown(each.name),
                "not set" if each.before is None else shown(shortened(each.before)),
                "not set" if each.after is None else shown(shortened(each.after)),
            )
            for each in changes
        ),
    )
