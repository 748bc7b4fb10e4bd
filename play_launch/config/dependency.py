"""What something waits for before it is started or loaded: ``depends_on`` and ``start_delay``.

A unit is what can depend on something, and be depended on: a member of the system by its full name,
or a composable node by the text of its `NodeKey`.
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Mapping


class Condition(StrEnum):
    """What has to hold."""

    STARTED = "started"
    LOADED = "loaded"
    ACTIVE = "active"
    """The unit is a managed node in the state active."""
    EXITED = "exited"
    """The process has exited with status 0."""
    LOG = "log"
    """A line that the unit wrote matches the pattern `subject`."""
    NODE = "node"
    """The ROS graph has a node of the name `subject`."""
    TOPIC = "topic"
    """The topic `subject` has a publisher."""
    SERVICE = "service"
    FILE = "file"


class UnitCondition(StrEnum):
    """The conditions that the key ``condition`` can name; the others have keys of their own."""

    STARTED = Condition.STARTED.value
    LOADED = Condition.LOADED.value
    ACTIVE = Condition.ACTIVE.value
    EXITED = Condition.EXITED.value


ABOUT_GRAPH: Final = frozenset({Condition.NODE, Condition.TOPIC, Condition.SERVICE})
"""Conditions that need the ROS graph."""


class OnTimeout(StrEnum):
    """What follows when a condition does not hold in time, or cannot hold any more."""

    FAIL = "fail"
    START = "start"


class Dependency(Struct, frozen=True, kw_only=True):
    """One condition."""

    condition: Condition
    unit: str = ""
    """What of the configuration it is about; empty where it is about the world outside."""
    subject: str = ""
    """Name, path or pattern, as the condition says."""
    timeout: float = math.inf
    """Seconds, from when the dependent waits and the unit does not wait itself any more."""
    on_timeout: OnTimeout = OnTimeout.FAIL

    def __str__(self) -> str:
        """Write it so that it fits behind "waits for"."""
        name = self.unit.rpartition(":")[2]
        return {
            Condition.STARTED: f"{name} to be started",
            Condition.LOADED: f"{name} to be loaded",
            Condition.ACTIVE: f"{name} to be active",
            Condition.EXITED: f"{name} to exit with status 0",
            Condition.LOG: f"a line of {name} that matches {self.subject}",
            Condition.NODE: f"the node {self.subject}",
            Condition.TOPIC: f"a publisher of {self.subject}",
            Condition.SERVICE: f"the service {self.subject}",
            Condition.FILE: f"the file {self.subject}",
        }[self.condition]


class StartRule(Struct, frozen=True, kw_only=True):
    """When a unit may start: all dependencies hold, and since then the delay has passed."""

    dependencies: tuple[Dependency, ...] = ()
    delay: float = 0.0
    """Seconds."""


class DependencyGraph:
    """The dependencies of all units."""

    def __init__(
        self, rules: Mapping[str, StartRule], members: Mapping[str, tuple[str, ...]]
    ) -> None:
        """Take the rules of units, and each member with its composable nodes."""
        self._members = members
        self._member_of = {unit: unit for unit in members}
        for member, nodes in members.items():
            self._member_of |= dict.fromkeys(nodes, member)
        # What is not there any more is of no concern.
        self._needs = {
            unit: [each for each in rule.dependencies if each.unit in self._member_of]
            for unit, rule in rules.items()
            if unit in self._member_of
        }

    def needs(self, unit: str) -> tuple[str, ...]:
        """Name the units whose start has to come before that of a unit, each once."""
        member = self._member_of[unit]
        found = [] if member == unit else [member]
        for dependency in self._needs.get(unit, ()):
            found.append(dependency.unit)
            if dependency.condition is Condition.LOADED:
                found += self._members.get(dependency.unit, ())
        return tuple(dict.fromkeys(found))

    def cycles(self) -> list[list[str]]:
        """Find units that wait for themselves: of each knot one path, its first unit at both ends.

        A path begins with the unit that is declared first.
        """
        needs = {unit: self.needs(unit) for unit in self._member_of}
        found = []
        for knot in strongly_connected(needs):
            first = min(knot, key=list(needs).index)
            if len(knot) > 1 or first in needs[first]:
                found.append(_shortest_way_round(first, knot, needs))
        return found

    def stopped_after(self) -> dict[str, frozenset[str]]:
        """Name for each member those that are stopped before it: the members that depend on it.

        Members whose nodes depend on one another in both directions are stopped together.
        """
        needs: dict[str, set[str]] = {member: set() for member in self._members}
        for unit, needed in self._needs.items():
            needs[self._member_of[unit]] |= {self._member_of[each.unit] for each in needed}
        before: dict[str, set[str]] = {member: set() for member in self._members}
        knots = {member: knot for knot in strongly_connected(needs) for member in knot}
        for member, others in needs.items():
            for each in others - knots[member]:
                before[each] |= knots[member]
        return {
            member: frozenset(other for each in knots[member] for other in before[each])
            for member in self._members
        }


def strongly_connected(edges: Mapping[str, tuple[str, ...] | set[str]]) -> list[frozenset[str]]:
    """Part a graph into its strongly connected components (Tarjan, without recursion).

    A component comes after those that it leads to.
    """
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    is_open: set[str] = set()
    found: list[frozenset[str]] = []
    for root in edges:
        if root in number:
            continue
        number[root] = lowest[root] = len(number)
        path = [(root, iter(edges[root]))]
        stack.append(root)
        is_open.add(root)
        while path:
            unit, rest = path[-1]
            for other in rest:
                if other not in number:
                    number[other] = lowest[other] = len(number)
                    stack.append(other)
                    is_open.add(other)
                    path.append((other, iter(edges[other])))
                    break
                if other in is_open:
                    lowest[unit] = min(lowest[unit], number[other])
            else:
                path.pop()
                if path:
                    above = path[-1][0]
                    lowest[above] = min(lowest[above], lowest[unit])
                if lowest[unit] == number[unit]:
                    component = set()
                    while unit not in component:
                        component.add(stack.pop())
                    is_open -= component
                    found.append(frozenset(component))
    return found


def _shortest_way_round(
    first: str, knot: frozenset[str], needs: Mapping[str, tuple[str, ...]]
) -> list[str]:
    """Go from a unit back to itself, breadth first, within a strongly connected component."""
    came_from: dict[str, str] = {}
    reached = [first]
    for unit in reached:
        for other in needs[unit]:
            if other == first:
                way = [first, unit]
                while way[-1] != first:
                    way.append(came_from[way[-1]])
                return way[::-1]
            if other in knot and other not in came_from:
                came_from[other] = unit
                reached.append(other)
    raise AssertionError("a component that does not lead back to itself")
