"""`machines` and `machine`: read where they stand."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.machines import MachineConfig
from play_launch.config.problems import excerpt
from play_launch.config.section import entries_of, validate_mapping
from play_launch.config.sections import MachineSection
from play_launch.config.source import path_from
from play_launch.config.text import similar
from play_launch.config.values import resolve_environment

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.config.tree import Cursor

_REMOTE_KEYS: Final = (
    "ssh",
    "setup",
    "play_launch",
    "service",
    "connect_timeout",
    "lost_after",
    "on_lost",
    "copy",
    "max_clock_offset",
)


def machines_at(at: Cursor | None) -> dict[str, MachineConfig]:
    """Return the machines that stand there; mistakes are reported."""
    found: dict[str, MachineConfig] = {}
    for entry, value in entries_of(at, "names of machines to their keys"):
        section = validate_mapping(MachineSection, value)
        variables = resolve_environment(value.value("environment"))
        if not (entry.key.isascii() and entry.key.isidentifier()):
            message = "a machine is named by letters, digits and _, not beginning with a digit"
            value.problem(message, entry.location)
        elif section is not None:
            found[entry.key] = _machine(entry.key, section, value, variables)
    local = [each.name for each in found.values() if each.local]
    if at is not None and len(local) > 1:
        at.below(local[1]).problem(f"only one machine is local, and {local[0]} is")
    return found


def _machine(
    name: str, section: MachineSection, at: Cursor, variables: dict[str, str]
) -> MachineConfig:
    given: dict[str, Any] = {
        key: tuple(each) if isinstance(each, list) else each
        for key, each in section.given.items()
        if key in MachineConfig.__struct_fields__
    }
    if section.local:
        for key in _REMOTE_KEYS:
            if at.value(key) is not None:
                at.at_key(key).problem("is for machines that ssh reaches, not for the local one")
    if section.on_lost is not None and section.on_lost.stop_after is not None:
        given["stop_after"] = section.on_lost.stop_after
    at_copy = at.at_key("copy")
    given["copy"] = tuple(path_from(at_copy, each).absolute() for each in section.copy or ())
    given["environment"] = MappingProxyType(variables)
    return MachineConfig(name=name, **given)


class Placement:
    """Says on which machine each container and process runs."""

    def __init__(
        self, at_document: Cursor, machines: dict[str, MachineConfig], default: str | None
    ) -> None:
        self._machines = machines
        self._local = next((name for name, each in machines.items() if each.local), "")
        self._default = self._local
        if default is not None and self._known(default, at_document.at_key("machine")):
            self._default = default

    def environment(self, machine: str) -> Mapping[str, str]:
        """Return the variables of a machine."""
        known = self._machines.get(machine)
        return {} if known is None else known.environment

    def place(self, at: Cursor, machine: str | None) -> str:
        """Return the machine of an entry; one that cannot be known is reported."""
        if machine is not None:
            return machine if self._known(machine, at.at_key("machine")) else ""
        if self._machines and not self._default:
            at.problem(
                "the key machine is missing, because no machine is local; give it here or at the "
                f"top level: one of {', '.join(self._machines)}"
            )
        return self._default

    def is_elsewhere(self, at: Cursor, machine: str) -> bool:
        """Whether an entry is of another machine than that one; without a name, than the local."""
        named = at.value("machine")
        place = self._default if named is None else named.string
        return place in self._machines and place != (machine or self._local)

    def _known(self, machine: str, at: Cursor) -> bool:
        if machine in self._machines:
            return True
        if not self._machines:
            at.problem(f"there is no machine {excerpt(machine)}; declare it in machines")
            return False
        close = similar(machine, list(self._machines))
        fix = f"did you mean {close}?" if close else f"declared are {', '.join(self._machines)}"
        at.problem(f"there is no machine {excerpt(machine)}; {fix}")
        return False
