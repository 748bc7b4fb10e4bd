"""`depends_on` and `start_delay`: read where they stand, resolved when all names are known."""

from __future__ import annotations

import os
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from play_launch.config.dependency import (
    Condition,
    Dependency,
    DependencyGraph,
    OnTimeout,
    StartRule,
)
from play_launch.config.model import ManagedConfig, OnExit
from play_launch.config.problems import excerpt
from play_launch.config.section import items_of, validate_mapping
from play_launch.config.sections import DependencySection
from play_launch.config.source import path_from
from play_launch.config.text import similar
from play_launch.config.values import NEVER

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from play_launch.config.model import ContainerConfig, ProcessConfig
    from play_launch.config.schema import ComposableNodeSection, ProcessSection
    from play_launch.config.tree import Cursor

_SUBJECTS: Final = ("name", "node", "topic", "service", "file", "expect")


class StartRules:
    """The declarations of members and nodes, and with `resolved` the rules that they mean."""

    def __init__(self, is_declared: Callable[[str], bool]) -> None:
        """`is_declared` is whether a full name is given, also in an entry that cannot be used."""
        self._is_declared = is_declared
        self._declared: list[tuple[str, Cursor | None, float]] = []
        self._managed: dict[str, ManagedConfig] = {}

    def declare(self, unit: str, at: Cursor, delay: float | None) -> None:
        dependencies = at.value("depends_on")
        if dependencies is not None or delay:
            self._declared.append((unit, dependencies, delay or 0.0))

    def declare_managed(
        self,
        unit: str,
        full_name: str | None,
        at: Cursor,
        section: ComposableNodeSection | ProcessSection,
    ) -> None:
        timeout = section.transition_timeout
        if section.autostart is None:
            if timeout is not None:
                at.at_key("transition_timeout").problem("only read with autostart; add that")
        elif full_name is None:
            message = "needs the name of the node, for its lifecycle services; give it a name"
            at.at_key("autostart").problem(message)
        else:
            given = {} if timeout is None else {"timeout": timeout}
            self._managed[unit] = ManagedConfig(full_name, section.autostart, **given)

    def managed(self, rules: Mapping[str, StartRule]) -> dict[str, ManagedConfig]:
        """Return the managed nodes, also those that others only wait for."""
        awaited = {
            each.unit: ManagedConfig("/" + each.unit.rpartition(":/")[2].removeprefix("/"))
            for rule in rules.values()
            for each in rule.dependencies
            if each.condition is Condition.ACTIVE
        }
        return awaited | self._managed

    def resolved(
        self,
        containers: Iterable[ContainerConfig],
        processes: Iterable[ProcessConfig],
        expected: Collection[str],
    ) -> dict[str, StartRule]:
        """Return the rules by member or node; unknown names and cycles are reported."""
        units = _Units(containers, processes, self._is_declared)
        rules: dict[str, StartRule] = {}
        locations: dict[tuple[str, str], Cursor] = {}
        for unit, at, delay in self._declared:
            dependencies = []
            for item in items_of(at, "dependencies"):
                dependency = _dependency(item, units, expected)
                if dependency is not None:
                    dependencies.append(dependency)
                    locations.setdefault((unit, dependency.unit), item)
            if units.named.get(unit) == [unit]:
                rules[unit] = StartRule(dependencies=tuple(dependencies), delay=delay)
        for cycle in DependencyGraph(rules, units.members).cycles():
            _report_cycle(cycle, locations)
        return rules


def _dependency(at: Cursor, units: _Units, expected: Collection[str]) -> Dependency | None:
    if at.string is not None:
        section = DependencySection({"name": at.string})
    else:
        found = validate_mapping(DependencySection, at)
        if found is None:
            return None
        section = found
    given = [key for key in _SUBJECTS if getattr(section, key) is not None]
    if len(given) != 1:
        message = f"give one of {', '.join(_SUBJECTS)}"
        at.problem(f"{message}; given are {', '.join(given)}" if given else message)
        return None
    unit, subject = "", ""
    if section.name is not None:
        other = units.find(section.name, at.at_key("name") if at.string is None else at)
        if other is None:
            return None
        unit = other
        condition, subject = units.condition(unit, section, at)
    else:
        for key in ("condition", "log"):
            if getattr(section, key) is not None:
                message = f"{key} is about the unit that name gives, not {given[0]}"
                at.at_key(key).problem(message)
        condition = Condition(given[0])
        if section.file is not None:
            subject = os.fspath(path_from(at.at_key("file"), section.file))
        else:
            subject = f"/{getattr(section, given[0]).removeprefix('/')}"
        if condition is Condition.EXPECT and subject not in expected:
            at.at_key("expect").problem(f"nothing is expected of {subject}; add it to expect")
    return Dependency(
        condition=condition,
        unit=unit,
        subject=subject,
        timeout=NEVER if section.timeout is None else section.timeout,
        on_timeout=section.on_timeout or OnTimeout.FAIL,
    )


class _Units:
    """The members and nodes by the names in the file."""

    def __init__(
        self,
        containers: Iterable[ContainerConfig],
        processes: Iterable[ProcessConfig],
        is_declared: Callable[[str], bool],
    ) -> None:
        self._is_declared = is_declared
        self._processes = {each.full_name: each for each in processes}
        self.members: dict[str, tuple[str, ...]] = {}
        self.named: dict[str, list[str]] = {}
        for container in containers:
            nodes = tuple(str(node.key) for node in container.composable_nodes)
            self.members[container.full_name] = nodes
            for node in container.composable_nodes:
                self.named.setdefault(node.declared_full_name, []).append(str(node.key))
                self.named[str(node.key)] = [str(node.key)]
        self.members |= dict.fromkeys(self._processes, ())
        self.named |= {name: [name] for name in self.members}

    def find(self, name: str, at: Cursor) -> str | None:
        full_name = f"/{name.removeprefix('/')}"
        found = self.named.get(full_name, [])
        if len(found) == 1:
            return found[0]
        if found:
            at.problem(f"several nodes are {name}; name one of {', '.join(found)}")
        elif not self._is_declared(full_name):  # else its own problem is reported
            close = similar(full_name, sorted(self.named))
            fix = f"did you mean {excerpt(close)}?" if close else "is it declared in this file?"
            at.problem(f"nothing is called {excerpt(name)}; {fix}")
        return None

    def condition(self, unit: str, section: DependencySection, at: Cursor) -> tuple[Condition, str]:
        if section.log is not None:
            if section.condition is not None:
                at.at_key("log").problem("give either condition or log")
            elif unit not in self.members:
                container = unit.partition(":/")[0]
                at.at_key("log").problem(f"a node writes through its container; name {container}")
            return Condition.LOG, section.log
        process = self._processes.get(unit)
        condition = section.condition
        if condition is None:
            condition = Condition.LOADED if process is None else Condition.STARTED
        why = self._never_holds(unit, process, condition)
        if why:
            at.at_key("condition").problem(f"{condition} {why}")
        if process is not None and condition is Condition.LOADED:
            return Condition.NODE, unit
        return condition, ""

    def _never_holds(self, unit: str, process: ProcessConfig | None, condition: Condition) -> str:
        if condition is Condition.EXITED:
            if process is None:
                return "is for processes"
            if process.on_exit is OnExit.RESTART:
                return f"never holds: {unit} is started again whenever it exits (on_exit: restart)"
        if condition is Condition.ACTIVE and process is None and unit in self.members:
            return "is for managed nodes, not for a container"
        needs_name = condition is Condition.ACTIVE or (
            condition is Condition.LOADED and process is not None
        )
        return "needs the name of the node; give it a name" if needs_name and "/[" in unit else ""


def _report_cycle(cycle: list[str], locations: dict[tuple[str, str], Cursor]) -> None:
    steps = []
    first: Cursor | None = None
    for unit, other in pairwise(cycle):
        # A node needs its container anyway, and all nodes of a container include each.
        at = locations.get((unit, other)) or locations.get((unit, other.partition(":/")[0]))
        first = first or at
        steps.append(f"{unit} ({at.node.location})" if at is not None else unit)
    assert first is not None
    first.problem(f"a dependency cycle: {' -> '.join([*steps, cycle[-1]])}")
