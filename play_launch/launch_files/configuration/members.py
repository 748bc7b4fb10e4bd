"""One container, composable node or process, as an entry of the configuration."""

from __future__ import annotations

import re
import shlex
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.model import ParameterType
from play_launch.config.values import check_topic
from play_launch.launch_files.configuration.request import Containers
from play_launch.launch_files.configuration.yaml_text import Commented
from play_launch.launch_files.records import ProgramKind

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.launch_files.configuration.files import Paths
    from play_launch.launch_files.configuration.references import Names
    from play_launch.launch_files.configuration.request import Options
    from play_launch.launch_files.configuration.sources import ParameterSources
    from play_launch.launch_files.records import Composable, LaunchedProcess, Losses, Unit

_TYPES: Final = {
    "component_container": "standard",
    "component_container_mt": "mt",
    "component_container_isolated": "isolated",
}
"""The container types that do what these programs do."""
_PACKAGES: Final = frozenset({"rclcpp_components", "play_launch_container"})
_ISOLATED: Final = {"standard": "isolated", "mt": "isolated_mt", "isolated": "isolated"}
_SEVERAL_THREADS: Final = "--use_multi_threaded_executor"
_THREADS: Final = "thread_num"
_IDENTITY: Final = ("__node:=", "__name:=", "__ns:=")
_LONGEST_PAUSE: Final = 30.0
_LEVELS: Final = {"warning": "warn", "critical": "fatal"}
_INTO_FILES: Final = frozenset({"log", "own_log"})
_YEAR: Final = 8760 * 3600.0
_FOR_ONE_NODE: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*:[A-Za-z0-9_/~{}]+", re.ASCII)
"""The source of a remapping for one node of a process, `node:topic`."""


class Members:
    """Writes entries; what they do not say is reported."""

    def __init__(
        self,
        options: Options,
        paths: Paths,
        sources: ParameterSources,
        names: Names,
        losses: Losses,
    ) -> None:
        self._options = options
        self._paths = paths
        self._sources = sources
        self._program_names = names
        self._losses = losses

    def container(self, unit: LaunchedProcess) -> dict[str, Any]:
        """Return the entry of a container, without its nodes."""
        entry = self._begin(unit)
        values = self._sources.values_of(unit, unit.parameters)
        arguments, for_ros = _parted(unit.arguments)
        kind = _TYPES.get(unit.executable) if unit.package in _PACKAGES else None
        if kind is None or self._options.containers is Containers.STOCK:
            if kind is None:
                program = unit.executable or " ".join(unit.command)
                note = f"keeps its program {program}, as a stock container"
                self._losses.note(unit.described, note)
            entry |= {
                "container_type": "stock",
                "package": unit.package,
                "executable": unit.executable,
            }
            if arguments:
                entry["arguments"] = arguments
        else:
            if kind == "isolated" and _SEVERAL_THREADS in arguments:
                kind = "isolated_mt"
                arguments.remove(_SEVERAL_THREADS)
            elif self._options.containers is Containers.ISOLATED:
                kind = _ISOLATED[kind]
            # `args=""` is an empty argument.
            arguments = [word for word in arguments if word]
            entry["container_type"] = kind
            threads = values.get(_THREADS)
            if kind.endswith("mt") and threads and threads.type is ParameterType.INTEGER:
                del values[_THREADS]
                if threads.value:
                    entry[_THREADS] = threads.value
            if arguments:
                self._lost(unit, f"arguments that its container has no use for: {arguments}")
        self._sources.add_sections(entry, unit, values)
        extra = self._without_names(unit, for_ros)
        for source, target in self._remappings(unit):
            extra += ["-r", f"{source}:={target}"]
        self._add_common(entry, unit, extra)
        # It comes back in any case, without `respawn` as often as ours do.
        _add_restart(entry, unit)
        if unit.ends_all:
            entry["on_exit"] = "shutdown"
        if unit.emulate_tty:
            self._losses.note(unit.described, "its output goes to no terminal (emulate_tty)")
        return entry

    def composable(self, unit: Composable) -> dict[str, Any]:
        """Return the entry of a composable node."""
        entry = self._begin(unit)
        entry |= {"package": unit.package, "plugin": unit.plugin}
        values = self._sources.values_of(unit, unit.parameters)
        if written := self._sources.written(unit, values):
            entry["parameters"] = written
        if remappings := dict(self._remappings(unit)):
            entry["remappings"] = remappings
        if unit.extra_arguments:
            entry["extra_arguments"] = {each.name: each.value for each in unit.extra_arguments}
        if level := unit.log_level.lower():
            entry["log_level"] = _LEVELS.get(level, level)
        self._add_lifecycle(entry, unit)
        return entry

    def process(self, unit: LaunchedProcess) -> dict[str, Any] | None:
        """Return the entry of a process; None where there is nothing to start."""
        entry = self._begin(unit)
        prefix = list(unit.prefix)
        if unit.package:
            entry |= {"package": unit.package, "executable": unit.executable}
            if unit.arguments:
                entry["arguments"] = unit.arguments
        elif unit.command:
            in_shell = unit.shell and unit.kind is ProgramKind.PROCESS
            entry["command"] = (
                ["/bin/sh", "-c", " ".join([*prefix, *unit.command])] if in_shell else unit.command
            )
            if in_shell:
                prefix = []
            if "name" not in entry and (label := self._program_names.label(unit)):
                entry["name"] = label
        else:
            self._lost(unit, "has neither a package nor a command, so nothing can be started")
            return None
        self._sources.add(entry, unit)
        extra: list[str] = []
        remappings = dict(self._remappings(unit, extra))
        if remappings:
            entry["remappings"] = remappings
        self._add_common(entry, unit, extra, prefix)
        if unit.emulate_tty:
            entry["emulate_tty"] = True
        if unit.ends_all:
            # launch does both; the restarted process is stopped at once.
            entry["on_exit"] = "shutdown"
        elif unit.respawn:
            entry["on_exit"] = "restart"
            _add_restart(entry, unit)
        self._add_lifecycle(entry, unit)
        return entry

    def _begin(self, unit: Unit) -> Commented:
        named: dict[str, Any] = {}
        if unit.name:
            named["name"] = unit.name
        if unit.namespace not in ("", "/"):
            named["namespace"] = unit.namespace
        place = unit.origin
        where = self._paths.shown(place.file) if place.file else ""
        return Commented(
            named, f"from {where}{f':{place.line}' if place.line else ''}" * bool(where)
        )

    def _add_common(
        self,
        entry: dict[str, Any],
        unit: LaunchedProcess,
        extra: list[str],
        prefix: list[str] | None = None,
    ) -> None:
        prefix = list(unit.prefix) if prefix is None else prefix
        if unit.shell and unit.kind is not ProgramKind.PROCESS:
            self._report_shell(unit)
        if unit.unset:
            prefix = ["env", *(word for name in unit.unset for word in ("-u", name)), *prefix]
        if prefix:
            entry["prefix"] = shlex.join(prefix)
        if unit.environment:
            entry["environment"] = dict(unit.environment)
        if arguments := [*self._without_names(unit, unit.ros_arguments), *extra]:
            entry["ros_arguments"] = arguments
        if unit.output in _INTO_FILES and not self._options.show_all:
            entry["output"] = "log"
        if unit.cwd:
            entry["cwd"] = unit.cwd

    def _report_shell(self, unit: LaunchedProcess) -> None:
        """Report what only a shell would make something else of."""
        words = [*unit.prefix, *unit.command, *unit.arguments, *unit.ros_arguments]
        special = [word for word in words if shlex.quote(word) != word]
        if special:
            what = f"shell: its words are given to the program as they are: {' '.join(special)}"
            self._lost(unit, what)

    def _add_lifecycle(self, entry: dict[str, Any], unit: Unit) -> None:
        if unit.autostart is not None:
            entry["autostart"] = str(unit.autostart)
        elif unit.is_lifecycle:
            self._losses.note(
                unit.described, "is a lifecycle node; only your own nodes activate it"
            )

    def _without_names(self, unit: LaunchedProcess, words: Iterable[str]) -> list[str]:
        """Return the arguments for ROS, without the marks that are put around them here."""
        kept: list[str] = []
        for word in words:
            if word in {"--ros-args", "--"}:
                continue
            if any(part in word for part in _IDENTITY):
                self._lost(unit, f"{word}: a name that its arguments give")
                if kept and kept[-1] in {"-r", "--remap"}:
                    kept.pop()
            else:
                kept.append(word)
        return kept

    def _remappings(self, unit: Unit, rest: list[str] | None = None) -> list[tuple[str, str]]:
        """Return the remappings that hold: the first of each name, as in rcl.

        Those that the key does not take become arguments in `rest`, where that is given.
        """
        found: dict[str, str] = {}
        for source, target in unit.remappings:
            try:
                check_topic(source)
                check_topic(target)
                if source.startswith("__"):
                    raise ValueError("the node's own name is given by name and namespace")  # noqa: TRY301
            except ValueError as error:
                if rest is not None and _FOR_ONE_NODE.fullmatch(source):
                    rest += ["-r", f"{source}:={target}"]
                else:
                    self._lost(unit, f"the remapping {source}:={target}: {error}")
                continue
            if found.setdefault(source, target) != target:
                note = f"{source} is remapped twice; the first holds, as in ROS"
                self._losses.note(unit.described, note)
        return list(found.items())

    def _lost(self, unit: Unit, what: str) -> None:
        self._losses.lost(unit.described, what)


def _parted(arguments: Iterable[str]) -> tuple[list[str], list[str]]:
    """Return the arguments of a program, and those that it leaves to ROS."""
    own: list[str] = []
    for_ros: list[str] = []
    into = own
    for word in arguments:
        if word == "--ros-args":
            into = for_ros
        elif word == "--" and into is for_ros:
            into = own
        else:
            into.append(word)
    return own, for_ros


def _add_restart(entry: dict[str, Any], unit: LaunchedProcess) -> None:
    restart: dict[str, Any] = {}
    if unit.respawn and unit.respawn_max_retries >= 0:
        # Counted from the start on, not within a time.
        restart |= {"max_restarts": unit.respawn_max_retries, "within": _YEAR}
    if delay := unit.respawn_delay:
        restart["backoff"] = {"initial": delay, "maximum": max(delay, _LONGEST_PAUSE)}
    if restart:
        entry["restart"] = restart
