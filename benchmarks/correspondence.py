"""Nodes that exchange numbered messages in a circle, and what they notice when others are changed.

Node `n` says its numbers to node `n + 1`, which lives in another container.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple

from benchmarks.figures import Figures

NODES = 30
KINDS = ("standard", "isolated", "isolated_mt")
"""The containers: one of each kind."""
CHANGED_PARAMETER, CHANGED_REMAPPING, REMOVED, ADDED = 3, 7, 11, NODES
"""The nodes that `changed` is about."""
_FIGURES = 6

Node = dict[str, Any]


class Letters(NamedTuple):
    """What one node has noticed, see fixtures/src/correspondent.cpp; times in ns."""

    pid: int
    heard: int
    missing: int
    began_anew: int
    longest_between_heard: int
    longest_between_said: int


def figures() -> Figures:
    """Make room for what all of them notice."""
    return Figures((NODES + 1) * _FIGURES)


def nodes(rate: float) -> dict[int, Node]:
    """Give the nodes of the circle by their numbers; ``rate`` is in Hz."""
    return {number: _node(number, rate) for number in range(NODES)}


def changed(before: Mapping[int, Node], rate: float) -> dict[int, Node]:
    """Change a parameter and a remapping of two nodes, take one out, add one."""
    after = {number: dict(node) for number, node in before.items()}
    parameters = after[CHANGED_PARAMETER]["parameters"]
    after[CHANGED_PARAMETER]["parameters"] = {**parameters, "note": "changed"}
    after[CHANGED_REMAPPING]["remappings"] = [
        *after[CHANGED_REMAPPING]["remappings"],
        "unused:=/elsewhere",
    ]
    del after[REMOVED]
    after[ADDED] = _node(ADDED, rate)
    return after


def system(found: Mapping[int, Node]) -> dict[str, Any]:
    """Make a configuration of nodes: each container has every third one."""
    return {
        "version": 1,
        "containers": [
            {
                "name": kind,
                "container_type": kind,
                "composable_nodes": [
                    node for number, node in found.items() if number % len(KINDS) == place
                ],
            }
            for place, kind in enumerate(KINDS)
        ],
    }


def untouched() -> list[int]:
    """Numbers of the nodes that hear one that is not touched, and are not touched themselves.

    A parameter that is set touches neither.
    """
    touched = {CHANGED_REMAPPING, REMOVED}
    return [n for n in range(NODES) if n not in touched and _heard_by(n) not in touched]


def noticed(found: Figures, numbers: Iterable[int]) -> dict[int, Letters]:
    """Read what these have noticed."""
    return {number: Letters(*found.read(number * _FIGURES, _FIGURES)) for number in numbers}


def forget_gaps(found: Figures, numbers: Collection[int]) -> None:
    """Have the longest gaps measured from now on."""
    for number in numbers:
        for place in (4, 5):
            found[number * _FIGURES + place] = 0


def _heard_by(number: int) -> int:
    return (number - 1) % NODES if number < NODES else NODES - 1


def _node(number: int, rate: float) -> Node:
    return {
        "package": "play_launch_demo",
        "plugin": "play_launch_demo::Correspondent",
        "name": f"node{number}",
        "parameters": {"figures": number * _FIGURES, "rate": rate, "note": ""},
        "remappings": [f"said:=/said{number}", f"heard:=/said{_heard_by(number)}"],
    }
