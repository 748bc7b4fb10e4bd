"""Makes a configuration from records, as plain values."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.resolve.nodes import NodeNames
from play_launch.launch_files.configuration.files import Paths, with_copies
from play_launch.launch_files.configuration.members import Members
from play_launch.launch_files.configuration.references import Names, add_order
from play_launch.launch_files.configuration.sources import ParameterSources
from play_launch.launch_files.records import Composable, LaunchedProcess, ProgramKind

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.launch_files.configuration.files import Copies
    from play_launch.launch_files.configuration.request import Options
    from play_launch.launch_files.records import Description, Losses, Unit

_USUAL: Final = 5.0
"""Seconds that launch gives a process to follow a signal by default."""


def pull_up(containers: list[dict[str, Any]], processes: list[dict[str, Any]]) -> dict[str, Any]:
    """Take what holds for all out of the entries, and return the keys of the top level for it."""
    top: dict[str, Any] = {}
    if environment := _environment([*containers, *processes]):
        top["environment"] = environment
    if kind := _container_type(containers):
        top["composable_node_loading"] = {"container_type": kind}
    return top


def _environment(entries: list[dict[str, Any]]) -> dict[str, str]:
    started = [entry for entry in entries if not entry.get("attach")]
    if len(started) < 2:
        return {}
    first, *others = (entry.get("environment", {}) for entry in started)
    common = {
        name: value
        for name, value in first.items()
        if all(each.get(name) == value for each in others)
    }
    for entry in started if common else ():
        for name in common:
            del entry["environment"][name]
        if not entry["environment"]:
            del entry["environment"]
    return common


def _container_type(containers: list[dict[str, Any]]) -> str:
    """Pull up the type that most containers have; a stock container always says that it is one."""
    counted = Counter(entry["container_type"] for entry in containers)
    del counted["stock"]
    kind, count = next(iter(counted.most_common(1)), ("", 0))
    if count < 2:
        return ""
    for entry in containers:
        if entry["container_type"] == kind:
            del entry["container_type"]
    return str(kind)


def stop_limits(processes: Iterable[LaunchedProcess], losses: Losses) -> dict[str, float]:
    """Return the key `stop`: limits hold for all, so the longest of each is taken.

    launch counts both from one signal to the next, as `sigint` and `sigterm` do. A process whose
    limit is not given keeps at least the one it has in launch; where none is given, the
    configuration's own hold.
    """
    found: dict[str, float] = {}
    for key, name in (("sigint", "sigterm_timeout"), ("sigterm", "sigkill_timeout")):
        given = {process.described: getattr(process, name) for process in processes}
        if all(each is None for each in given.values()):
            continue
        found[key] = max(_USUAL if each is None else each for each in given.values())
        for where, own in given.items():
            if own is not None and own != found[key]:
                what = f"its {name} of {own:g} s; the longest, {found[key]:g} s, holds for all"
                losses.note(where, what)
    return found


def configuration_of(
    description: Description, options: Options, copies: Copies | None, losses: Losses
) -> dict[str, Any]:
    """Return the configuration; what it does not say is reported."""
    description = with_copies(description, copies, losses)
    paths = Paths(options.folder)
    sources = ParameterSources(options, paths, copies, losses)
    names = Names(description.units)
    members = Members(options, paths, sources, names, losses)
    return _Builder(names.distinct(losses), members, losses).built()


class _Builder:
    def __init__(self, units: list[Unit], members: Members, losses: Losses) -> None:
        self._units = units
        self._members = members
        self._losses = losses
        self._containers: dict[str, dict[str, Any]] = {}
        self._processes: list[dict[str, Any]] = []
        self._entries: list[tuple[Unit, dict[str, Any]]] = []
        self._names: dict[str, str] = {}
        self._labels = NodeNames()

    def built(self) -> dict[str, Any]:
        hosts = {unit.container for unit in self._units if isinstance(unit, Composable)}
        for unit in self._units:
            if isinstance(unit, LaunchedProcess):
                self._add_process(unit, is_host=unit.full_name in hosts or unit.name in hosts)
        for unit in self._units:
            if isinstance(unit, Composable):
                self._add_composable(unit)
        by_id = {unit.id: unit for unit in self._units if unit.id}
        for unit, entry in self._entries:
            add_order(entry, unit, by_id, self._names, self._losses)
        containers = list(self._containers.values())
        for entry in containers:
            if nodes := entry.pop("composable_nodes", None):
                entry["composable_nodes"] = nodes
        values: dict[str, Any] = {"version": 1}
        processes = [unit for unit in self._units if isinstance(unit, LaunchedProcess)]
        if limits := stop_limits(processes, self._losses):
            values["stop"] = limits
        values |= pull_up(containers, self._processes)
        if containers:
            values["containers"] = containers
        if self._processes:
            values["nodes"] = self._processes
        return values

    def _add_process(self, unit: LaunchedProcess, *, is_host: bool) -> None:
        if unit.name and (unit.kind is ProgramKind.CONTAINER or is_host) and unit.package:
            entry = self._members.container(unit)
            self._containers[unit.full_name] = entry
            self._names[unit.id] = unit.full_name
            if not unit.respawn and not unit.ends_all:
                self._losses.note("(containers)", "come back when they end, as with respawn")
        else:
            made = self._members.process(unit)
            if made is None:
                return
            entry = made
            self._processes.append(entry)
            # As the configuration names it where nothing else does.
            program = unit.executable or (unit.command[0] if unit.command else "")
            namespace = str(entry.get("namespace", ""))
            self._names[unit.id] = (
                f"{namespace}/{entry['name']}"
                if "name" in entry
                else self._labels.label("", namespace, program.rpartition("/")[2])
            )
        self._entries.append((unit, entry))

    def _add_composable(self, unit: Composable) -> None:
        host, container = self._host(unit)
        entry = self._members.composable(unit)
        container.setdefault("composable_nodes", []).append(entry)
        # The same name may be given in two containers where it is a label.
        name = unit.full_name or self._labels.label(host, unit.namespace, unit.plugin)
        self._names[unit.id] = f"{host}:{name}"
        self._entries.append((unit, entry))

    def _host(self, unit: Composable) -> tuple[str, dict[str, Any]]:
        """Return the container of a composable node; one that is not started is attached to."""
        target = unit.container
        alike = [
            name
            for name in self._containers
            if name == target or name.rpartition("/")[2] == target.removeprefix("/")
        ]
        if target in alike:
            alike = [target]
        if len(alike) > 1:
            note = f"{len(alike)} containers are called {target}; the first is taken"
            self._losses.note(unit.described, note)
        if alike:
            return alike[0], self._containers[alike[0]]
        full_name = target if target.startswith("/") else f"/{target}"
        note = f"nothing here starts its container {full_name}; it is attached to"
        self._losses.note(unit.described, note)
        namespace, _, name = full_name.rpartition("/")
        entry: dict[str, Any] = {"name": name, **({"namespace": namespace} if namespace else {})}
        entry |= {"container_type": "stock", "attach": True}
        return full_name, self._containers.setdefault(full_name, entry)
