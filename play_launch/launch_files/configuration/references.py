"""Unique names, which a configuration requires, and what waits for what by them."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from itertools import count
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from play_launch.config.values import check_node_name
from play_launch.launch_files.records import Event, LaunchedProcess, ProgramKind

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.launch_files.records import Losses, StartCondition, Unit

_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9]+", re.ASCII)


class Names:
    """Those of the units of one description."""

    def __init__(self, units: list[Unit]) -> None:
        """Keep the names of nodes for the first that has each."""
        self._units = units
        self._taken = {unit.full_name for unit in units}
        self._numbers: defaultdict[str, Iterator[int]] = defaultdict(lambda: count(2))

    def distinct(self, losses: Losses) -> list[Unit]:
        """Return the units with a number for each node from the second of a name on.

        A second container of a name is left out: what is loaded into that name goes to the first.
        """
        seen: set[str] = set()
        found: list[Unit] = []
        said: dict[str, tuple[str, str]] = {}
        more: Counter[str] = Counter()
        for unit in self._units:
            name = unit.full_name
            if not name or name not in seen:
                seen.add(name)
                found.append(unit)
                continue
            what = f"a second container is called {name}; it is left out"
            if not _is_container(unit):
                found.append(replace(unit, name=self._free(unit.namespace, unit.name)))
                what = f"a second node is called {name}; it becomes {found[-1].full_name}"
            more[name] += name in said
            said.setdefault(name, (unit.described, what))
        for name, (where, what) in said.items():
            losses.lost(where, f"{what}; {more[name]} more of that name" if more[name] else what)
        return found

    def label(self, unit: LaunchedProcess) -> str:
        """Return a name for a program that is no node; empty: launch gives it none.

        For launch it is a word in its output, and any number of programs have the same.
        """
        if unit.kind is not ProgramKind.PROCESS or not unit.label:
            return ""
        label = _NOT_IN_NAMES.sub("_", unit.label).strip("_")
        try:
            check_node_name(label)
        except ValueError:
            return ""
        full_name = f"{unit.namespace.rstrip('/')}/{label}"
        if full_name in self._taken:
            return self._free(unit.namespace, label)
        self._taken.add(full_name)
        return label

    def _free(self, namespace: str, name: str) -> str:
        """Return the name with the next free number."""
        base = f"{namespace.rstrip('/')}/{name}"
        numbered = (f"_{number}" for number in self._numbers[base])
        suffix = next(each for each in numbered if base + each not in self._taken)
        self._taken.add(base + suffix)
        return name + suffix


def _is_container(unit: Unit) -> bool:
    return isinstance(unit, LaunchedProcess) and unit.kind is ProgramKind.CONTAINER


_ACTIVE: Final = "active"


def add_order(
    entry: dict[str, Any],
    unit: Unit,
    units: Mapping[str, Unit],
    names: Mapping[str, str],
    losses: Losses,
) -> None:
    """Add `depends_on` and `start_delay` to the entry of a unit.

    `units` are all by id, `names` what the configuration calls those that it has.
    """
    delay = 0.0
    dependencies: list[Any] = []
    for condition in unit.start:
        if condition.event is Event.DELAY:
            delay += condition.seconds
            continue
        target = units.get(condition.unit)
        name = names.get(condition.unit)
        if target is None or name is None:
            losses.lost(unit.described, f"waits for something that is not there: {condition.event}")
            continue
        dependency = _dependency(condition, target, name)
        if isinstance(dependency, str):
            losses.lost(unit.described, f"does not wait: {dependency}")
        elif dependency not in dependencies:
            dependencies.append(dependency)
    if dependencies:
        entry["depends_on"] = dependencies
    if delay:
        entry["start_delay"] = delay


def _dependency(condition: StartCondition, target: Unit, name: str) -> dict[str, Any] | str:
    """Return the entry of `depends_on`, or the reason why it cannot have one."""
    is_process = isinstance(target, LaunchedProcess)
    match condition.event:
        case Event.STARTED if is_process:
            return {"name": name, "condition": "started"}
        case Event.EXITED if is_process:
            if isinstance(target, LaunchedProcess) and target.respawn:
                return f"{name} is started again whenever it exits"
            # The launch file does not ask for an exit status.
            return {"name": name, "condition": "exited", "on_timeout": "start"}
        case Event.STATE if condition.state == _ACTIVE:
            return {"name": name, "condition": "active"}
    return f"{condition.event} {condition.state} of {name} cannot be said".replace("  ", " ")
