"""What was wrong in a session, as data and words."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from msgspec import Struct
from msgspec.structs import replace

from play_launch.postmortem import detect
from play_launch.postmortem.parameters import ParametersOfALife  # noqa: TC001 - as above
from play_launch.postmortem.samples import Trend  # noqa: TC001 - as above
from play_launch.postmortem.source_lines import Module, SourceLine  # noqa: TC001 - as above
from play_launch.postmortem.units import Downtime  # noqa: TC001 - as above
from play_launch.supervisor.frames import Signature, StackFrame  # noqa: TC001 - fields of a Struct

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from play_launch.postmortem.timeline import Timeline


class DeclaredPlace(Struct, frozen=True, kw_only=True):
    """Where something happened; what is not known is empty."""

    frame: StackFrame | None = None
    line: SourceLine | None = None
    package: str = ""
    plugin: str = ""
    container: str = ""
    config: str = ""
    """``robot.yaml:12``: where it is declared."""
    command: tuple[str, ...] = ()
    """Of an ordinary process or a container."""
    machine: str = ""
    """Where it runs, in a system of several machines."""


class Finding(Struct, frozen=True, kw_only=True):
    """One thing that was wrong; equal things that happened to the same unit are one."""

    kind: str
    rank: int
    """Importance: small numbers come first, equal ones in the order of time."""
    is_failure: bool = True
    """Whether it is reported as something wrong."""
    says: str
    """Headline: ``{when}`` is the time of the first one with their number, ``{at}`` without."""
    name: str = ""
    """Name of the node, container or process; empty for the machine."""
    key: str = ""
    times_ns: tuple[int, ...]
    """When it happened, in nanoseconds since the epoch; the first is what the rest is about."""
    cause: str = ""
    known: str = ""
    """Name of the well-known cause, see `play_launch.postmortem.known_causes`."""
    place: DeclaredPlace = DeclaredPlace()
    frames: tuple[StackFrame, ...] = ()
    lines: tuple[SourceLine | None, ...] = ()
    """Of each frame; empty before they are looked up."""
    modules: tuple[Module, ...] = ()
    signature: Signature | None = None
    is_crash: bool = False
    state: str = ""
    """Which state it was in before, in the recording's words (``loaded``); empty: not known."""
    since_ns: int = 0
    """Since when, in nanoseconds since the epoch."""
    last_lines: tuple[str, ...] = ()
    before: tuple[Trend, ...] = ()
    """What grew or ran out before."""
    trends: tuple[Trend, ...] = ()
    """The numbers of the cause."""
    parameters: ParametersOfALife | None = None
    """Those that it had in the life that ended so; None: not known."""
    hit: tuple[str, ...] = ()
    """Names of other units that were down because of it, or waited."""
    done: tuple[str, ...] = ()
    """What the supervisor did."""
    away: tuple[Downtime, ...] = ()
    chain: tuple[str, ...] = ()
    """What it waited for, unit by unit, back to the start."""
    problems: tuple[str, ...] = ()
    """Why something that one would expect to read here is not known."""

    @property
    def at_ns(self) -> int:
        """When it happened first."""
        return self.times_ns[0]


def findings(timeline: Timeline) -> tuple[Finding, ...]:
    """Give what was wrong in a session that was read to its end, the most important first."""
    places: dict[str, DeclaredPlace] = {}
    for config in (timeline.session.resolved, *timeline.session.applied):
        places |= declared_places(config)
    commands = {unit.key: unit.command for unit in timeline.units if unit.command}
    found = [
        replace(each, place=_place(each, places, commands))
        for module in _modules()
        for each in module.detect(timeline)
    ]
    return tuple(sorted(found, key=lambda each: (each.rank, each.at_ns)))


def is_wrong(found: Sequence[Finding]) -> bool:
    """Whether any of them is a failure."""
    return any(each.is_failure for each in found)


def _modules() -> Iterator[Any]:
    for each in pkgutil.iter_modules(detect.__path__):
        yield import_module(f"{detect.__name__}.{each.name}")


def _place(
    finding: Finding, places: dict[str, DeclaredPlace], commands: dict[str, tuple[str, ...]]
) -> DeclaredPlace:
    """Complete a place by the command that was run, and by what was declared last."""
    key, known = finding.key, finding.place
    declared = places.get(key, DeclaredPlace())
    return DeclaredPlace(
        frame=known.frame,
        line=known.line,
        package=known.package or declared.package,
        plugin=known.plugin or declared.plugin,
        container=declared.container or known.container,
        config=declared.config,
        command=commands.get(key) or declared.command,
        machine=declared.machine,
    )


def declared_places(config: dict[str, Any]) -> dict[str, DeclaredPlace]:
    """Give the place of each declared thing, by its key; empty where it cannot be read."""
    try:
        return dict(_places(config))
    except (KeyError, ValueError, TypeError, AttributeError):
        return {}


def _places(config: dict[str, Any]) -> Iterator[tuple[str, DeclaredPlace]]:
    source = str(config.get("source", ""))
    for container in config.get("containers", ()):
        name, machine = container["full_name"], str(container.get("machine") or "")
        yield name, DeclaredPlace(config=_line(container, source), machine=machine)
        for node in container.get("composable_nodes", ()):
            yield (
                node["key"],
                DeclaredPlace(
                    package=node["package"],
                    plugin=node["plugin"],
                    container=name,
                    config=_line(node, source),
                    machine=machine,
                ),
            )
    for process in config.get("nodes", ()):
        command = process.get("command") or ()
        yield (
            process["full_name"],
            DeclaredPlace(
                package=process.get("package") or "",
                config=_line(process, source),
                command=tuple(map(str, command)),
                machine=str(process.get("machine") or ""),
            ),
        )


def _line(declared: dict[str, Any], source: str) -> str:
    # An older recording names no file: it has only one.
    file = PurePath(str(declared.get("file") or source)).name
    return f"{file}:{declared['line']}"
