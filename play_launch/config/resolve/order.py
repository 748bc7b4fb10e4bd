"""`depends_on` and `start_delay`: read where they stand, resolved when all names are known."""

from __future__ import annotations

import os
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec import Struct, field

from play_launch.config.dependency import (
    Condition,
    Dependency,
    DependencyGraph,
    OnTimeout,
    StartRule,
    UnitCondition,
)
from play_launch.config.model import ManagedConfig, OnExit
from play_launch.config.problems import excerpt
from play_launch.config.section import items_of, validate_mapping
from play_launch.config.sections import DependencySection
from play_launch.config.source import path_from
from play_launch.config.values import NEVER

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from play_launch.config.model import ContainerConfig, ProcessConfig
    from play_launch.config.schema import ComposableNodeSection, ProcessSection
    from play_launch.config.tree import Cursor

_SUBJECTS: Final = ("name", "node", "topic", "service", "file")
_CLOSE_ENOUGH: Final = 0.6


class _Declared(NamedTuple):
    unit: str
    dependencies: Cursor | None
    """What stands at `depends_on`."""
    delay: float


class StartRules(Struct):
    """What was declared so far, and with `resolved` what it means."""

    is_declared: Callable[[str], bool]
    """Whether a full name is given, also in an entry that cannot be used."""
    _declared: list[_Declared] = field(default_factory=list)
    _managed: dict[str, ManagedConfig] = field(default_factory=dict)

    def declare(self, unit: str, at: Cursor, delay: float | None) -> None:
        """Take what the entry of a unit says."""
        dependencies = at.value("depends_on")
        if dependencies is not None or delay:
            self._declared.append(_Declared(unit, dependencies, delay or 0.0))

    def declare_managed(
        self,
        unit: str,
        full_name: str | None,
        at: Cursor,
        section: ComposableNodeSection | ProcessSection,
    ) -> None:
        """Take whether a node is a managed one that is brought somewhere."""
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
        """Return the managed nodes by unit, also those that others only wait for."""
        awaited = {
            each.unit: ManagedConfig("/" + each.unit.rpartition(":/")[2].removeprefix("/"))
            for rule in rules.values()
            for each in rule.dependencies
            if each.condition is Condition.ACTIVE
        }
        return awaited | self._managed

    def resolved(
        self, containers: Iterable[ContainerConfig], processes: Iterable[ProcessConfig]
    ) -> dict[str, StartRule]:
        """Return the rules by unit; unknown names and cycles are reported."""
        units = _Units(containers, processes, self.is_declared)
        rules: dict[str, StartRule] = {}
        locations: dict[tuple[str, str], Cursor] = {}
        for unit, at, delay in self._declared:
            dependencies = []
            for item in items_of(at, "dependencies"):
                dependency = self._dependency(item, units)
                if dependency is not None:
                    dependencies.append(dependency)
                    locations.setdefault((unit, dependency.unit), item)
            if unit in units:
                rules[unit] = StartRule(dependencies=tuple(dependencies), delay=delay)
        for cycle in DependencyGraph(rules, units.members).cycles():
            _report_cycle(cycle, locations)
        return rules

    def _dependency(self, at: Cursor, units: _Units) -> Dependency | None:
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
        if given != ["name"]:
            for key in ("condition", "log"):
                if getattr(section, key) is not None:
                    at.at_key(key).problem(
                        f"{key} is about the unit that name gives, not {given[0]}"
                    )
        common = _Common(
            NEVER if section.timeout is None else section.timeout,
            section.on_timeout or OnTimeout.FAIL,
        )
        if section.name is None:
            return self._about_the_world(section, common, at)
        other = units.find(section.name, at.at_key("name") if at.string is None else at)
        if other is None:
            return None
        return units.about(other, section, common, at)

    def _about_the_world(
        self, section: DependencySection, common: _Common, at: Cursor
    ) -> Dependency:
        if section.file is not None:
            return common.dependency(
                Condition.FILE, subject=os.fspath(path_from(at.at_key("file"), section.file))
            )
        for condition in (Condition.NODE, Condition.TOPIC, Condition.SERVICE):
            name = getattr(section, condition)
            if name is not None:
                return common.dependency(condition, subject=f"/{name.removeprefix('/')}")
        raise AssertionError("no subject")


class _Common(NamedTuple):
    """What every kind of dependency can say."""

    timeout: float
    on_timeout: OnTimeout

    def dependency(self, condition: Condition, *, unit: str = "", subject: str = "") -> Dependency:
        return Dependency(
            condition=condition,
            unit=unit,
            subject=subject,
            timeout=self.timeout,
            on_timeout=self.on_timeout,
        )


class _Units:
    """The units by the names that people give them."""

    def __init__(
        self,
        containers: Iterable[ContainerConfig],
        processes: Iterable[ProcessConfig],
        is_declared: Callable[[str], bool],
    ) -> None:
        self._is_declared = is_declared
        self._processes = {each.full_name: each for each in processes}
        self.members: dict[str, tuple[str, ...]] = {}
        self._named: dict[str, list[str]] = {}
        for container in containers:
            nodes = tuple(str(node.key) for node in container.composable_nodes)
            self.members[container.full_name] = nodes
            for node in container.composable_nodes:
                self._named.setdefault(node.declared_full_name, []).append(str(node.key))
                self._named[str(node.key)] = [str(node.key)]
        self.members |= dict.fromkeys(self._processes, ())
        self._named |= {name: [name] for name in self.members}

    def __contains__(self, unit: str) -> bool:
        return self._named.get(unit) == [unit]

    def find(self, name: str, at: Cursor) -> str | None:
        """Return the unit; report a name that is unknown, or that several have."""
        full_name = name if name.startswith("/") else f"/{name}"
        found = self._named.get(full_name, [])
        if len(found) == 1:
            return found[0]
        if found:
            at.problem(f"several nodes are {name}; name one of {', '.join(found)}")
            return None
        if self._is_declared(full_name):  # what is wrong with it is reported already
            return None
        import difflib  # noqa: PLC0415 - a good file needs no guesses

        known = sorted(self._named)
        parts = {each.rpartition("/")[2]: each for each in known}
        wanted = name.rpartition("/")[2]
        close = difflib.get_close_matches(f"/{name.lstrip('/')}", known, 1, _CLOSE_ENOUGH)
        close = close or [
            parts[each] for each in difflib.get_close_matches(wanted, parts, 1, _CLOSE_ENOUGH)
        ]
        fix = f"did you mean {excerpt(close[0])}?" if close else "is it declared in this file?"
        at.problem(f"nothing is called {excerpt(name)}; {fix}")
        return None

    def about(
        self, unit: str, section: DependencySection, common: _Common, at: Cursor
    ) -> Dependency | None:
        """Return what `section` says about a unit; report what can never hold for it."""
        if section.log is not None:
            if section.condition is not None:
                at.at_key("log").problem("give either condition or log")
            elif unit not in self.members:
                container = unit.partition(":/")[0]
                at.at_key("log").problem(f"a node writes through its container; name {container}")
            return common.dependency(Condition.LOG, unit=unit, subject=section.log)
        process = self._processes.get(unit)
        condition = section.condition
        if condition is None:
            condition = UnitCondition.LOADED if process is None else UnitCondition.STARTED
        why = self._never_holds(unit, process, condition)
        if why:
            at.at_key("condition").problem(f"{condition} {why}")
        if process is not None and condition is UnitCondition.LOADED:
            return common.dependency(Condition.NODE, unit=unit, subject=unit)
        return common.dependency(Condition(condition.value), unit=unit)

    def _never_holds(
        self, unit: str, process: ProcessConfig | None, condition: UnitCondition
    ) -> str:
        if condition is UnitCondition.EXITED:
            if process is None:
                return "is for processes"
            if process.on_exit is OnExit.RESTART:
                return f"never holds: {unit} is started again whenever it exits (on_exit: restart)"
        if condition is UnitCondition.ACTIVE and process is None and unit in self.members:
            return "is for managed nodes, not for a container"
        needs_name = condition is UnitCondition.ACTIVE or process is not None
        if condition in {UnitCondition.ACTIVE, UnitCondition.LOADED} and needs_name:
            return "needs the name of the node; give it a name" if "/[" in unit else ""
        return ""


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
