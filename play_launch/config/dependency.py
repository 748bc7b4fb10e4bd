"""What something waits for before it is started or loaded: ``depends_on`` and ``start_delay``.

A unit is what can depend on something, and be depended on: a member of the system by its full name,
or a composable node by the text of its `NodeKey`.
"""

from __future__ import annotations

import math
from enum import StrEnum
from graphlib import CycleError, TopologicalSorter
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
    EXPECT = "expect"
    """The topic `subject` is as expected."""


OF_UNITS: Final = (Condition.STARTED, Condition.LOADED, Condition.ACTIVE, Condition.EXITED)
"""Conditions that the key ``condition`` can name; the others have keys of their own."""
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
    machine: str = ""
    """Where the unit runs, if that is another machine; its session reports the condition."""

    def __str__(self) -> str:
        """Write it so that it fits behind "waits for"."""
        name = self.unit.rpartition(":")[2]
        place = f" on {self.machine}" if self.machine else ""
        return self._text(name) + place

    def _text(self, name: str) -> str:
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
            Condition.EXPECT: f"{self.subject} to be as expected",
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
        """Find units that wait for themselves: disjoint paths with the same unit at both ends.

        A path begins with the unit that is declared first.
        """
        needs = {unit: self.needs(unit) for unit in self._member_of}
        declared = list(needs)
        found = []
        while True:
            try:
                TopologicalSorter(needs).prepare()
            except CycleError as error:
                cycle = error.args[1][:0:-1]  # each unit after the one that needs it
                first = min(range(len(cycle)), key=lambda index: declared.index(cycle[index]))
                found.append([*cycle[first:], *cycle[: first + 1]])
                needs = {
                    unit: tuple(each for each in needed if each not in cycle)
                    for unit, needed in needs.items()
                    if unit not in cycle
                }
            else:
                return found

    def stopped_after(self) -> dict[str, frozenset[str]]:
        """Name for each member those that are stopped before it: the members that depend on it.

        Members whose nodes depend on one another in both directions are stopped together.
        """
        needs: dict[str, set[str]] = {member: set() for member in self._members}
        for unit, needed in self._needs.items():
            needs[self._member_of[unit]] |= {self._member_of[each.unit] for each in needed}
        before: dict[str, set[str]] = {member: set() for member in self._members}
        paths = {member: _reachable(member, needs) for member in needs}
        knots = {
            member: {member, *(each for each in reached if member in paths[each])}
            for member, reached in paths.items()
        }
        for member, others in needs.items():
            for each in others - knots[member]:
                before[each] |= knots[member]
        return {
            member: frozenset(other for each in knots[member] for other in before[each])
            for member in self._members
        }


def _reachable(start: str, edges: Mapping[str, set[str]]) -> set[str]:
    """Return what a path of at least one edge leads to."""
    found: set[str] = set()
    left = [start]
    while left:
        new = edges[left.pop()] - found
        found |= new
        left += new
    return found
